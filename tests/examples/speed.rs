//! Speed of the simulator: `cargo run --release -p haptimill-tests --example speed -- FILE.ngc
//! [STOCK.toml]`.
//!
//! With a workpiece, mill, structure and sensor are computed in every period. A second thread
//! writes the recording; `taskset -c 0` puts both on one core.
use haptimill_client::client::Options;
use haptimill_client::session::{
    JobLine, JobRecording, Line as _, NoObserver, Session, SimLine, rig,
};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_machine_file::model::{Model, program_options, settings};
use haptimill_machine_file::{MachineFile, stock};
use haptimill_planner::Plan;
use haptimill_trace::{Header, Recorder};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

fn main() {
    let file = std::env::args().nth(1).expect("a part program");
    let machine = MachineFile::built_in().expect("sound");
    let cutting = std::env::args().nth(2).map(|work| {
        let plant: PlantConfig = machine.plant().expect("a plant");
        plant.cutting(stock::load(Path::new(&work)).expect("sound"))
    });
    let model = Model::new(&machine);
    let home = model.home(&machine).expect("a pose");
    let text = std::fs::read(&file).expect("readable");
    let begun = Instant::now();
    let program = haptimill_gcode::read(
        &file,
        &text,
        &program_options(&machine, model.to_engineering_units(&home)),
    )
    .expect("sound");
    let plan = Arc::new(Plan::new(&program, &settings(&machine), &model).expect("possible"));
    println!("plan      {:8.1} ms", begun.elapsed().as_secs_f64() * 1e3);
    for recorded in [false, true] {
        let line = SimLine::new(rig(&machine, None, None, vec![]).expect("sound"));
        let mut session = Session::new(
            line,
            &machine,
            Options::default(),
            Arc::new(AtomicBool::new(false)),
        );
        session.connect(1).expect("answers");
        session.configure(&machine).expect("taken");
        session.enable().expect("enabled");
        session.go_home(&machine, &home).expect("homed");
        if let Some(cutting) = &cutting {
            session.line_mut().clamp(cutting).expect("clamped");
        }
        let path = std::env::temp_dir().join("haptimill-speed.hmr");
        if recorded {
            let header = Header::of(&machine, "speed").expect("encodes");
            let recorder = Recorder::create(&path, &header).expect("created");
            session.line_mut().begin_recording(JobRecording::new(
                recorder,
                Plan::clone(&plan).into(),
                &machine,
            ));
        }
        let (before, begun) = (session.now_us(), Instant::now());
        session
            .run_job(2, home.clone(), plan.setpoints.clone(), &mut NoObserver)
            .expect("done");
        let wall = begun.elapsed().as_secs_f64();
        let simulated = (session.now_us() - before) as f64 / 1e6;
        println!(
            "{}  {:8.1} ms for {simulated:.1} s: {:.0} times real time, {:.0} ns a period",
            if recorded { "recorded" } else { "job     " },
            wall * 1e3,
            simulated / wall,
            wall / simulated * 2e5
        );
        if let Some(recorder) = session.line_mut().end_recording() {
            let begun = Instant::now();
            let recorded = recorder.finish().expect("written");
            println!(
                "finish    {:8.1} ms, {} MB",
                begun.elapsed().as_secs_f64() * 1e3,
                recorded.bytes / 1_000_000
            );
            let _ = std::fs::remove_file(&path);
        }
    }
}
