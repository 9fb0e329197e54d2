//! `override`, `hold`, `resume` and `stop` from a second process while a job runs.

use crate::scene::{SimServer, TestFolder, number, start};

/// Time of the program below at 100 %: 40 mm at 5 mm/s.
const PROGRAM: &str = "G21 G90 F300\nM3 S4000\nG1 X10\nG1 X0\nG1 X10\nG1 X0\nM30\n";

struct Scene {
    served: SimServer,
    folder: TestFolder,
    part: String,
}

impl Scene {
    fn new() -> Self {
        let served = SimServer::on_tcp(&[]);
        served.run_ok(&["home"]);
        let folder = TestFolder::new();
        let part = folder.file("part.ngc", PROGRAM);
        Self {
            served,
            folder,
            part,
        }
    }

    fn ask(&self, command: &[&str]) -> crate::scene::RunResult {
        self.served.run(command)
    }

    /// Starts the program, and waits until it takes requests.
    fn run(&self, more: &[&str]) -> crate::scene::Running {
        let out = self.folder.path("out");
        let run = [
            "run",
            &self.part,
            "--out",
            &out,
            "--port",
            &self.served.port,
        ];
        let run = start(&[&run[..], more].concat());
        for _ in 0..100 {
            if self.ask(&["override"]).code == 0 {
                return run;
            }
            std::thread::sleep(std::time::Duration::from_millis(50));
        }
        panic!("the run takes no requests: {:?}", run.end());
    }
}

#[test]
fn a_second_process_changes_the_overrides_of_a_job() {
    let scene = Scene::new();
    let mut run = scene.run(&[]);
    let shown = scene.ask(&["override"]).expect_code(0);
    assert!(
        shown.out.contains("feed 100 %, rapid 100 %, spindle 100 %"),
        "{}",
        shown.out
    );
    let set = ["override", "--feed", "200", "--spindle", "120", "--json"];
    let set = scene.ask(&set).expect_code(0).json();
    let text = set["done"].as_str().unwrap();
    assert!(
        text.contains("feed 200 %, rapid 100 %, spindle 120 %"),
        "{text}"
    );
    assert!(run.runs());
    run.end().expect_code(0);
    let summary = scene.folder.summary("out");
    assert_eq!(summary["completed"], true);
    // 8 s at 100 %; 4 s and the ramps at 200 %, from the first second on.
    let took = number(&summary, "duration_s");
    assert!((4.0..7.0).contains(&took), "{took} s");
}

/// The process that runs the job reports the status, which needs no session of its own.
#[test]
fn a_second_process_reads_the_status_of_a_job() {
    let scene = Scene::new();
    let run = scene.run(&[]);
    let status = scene.ask(&["status", "--json"]).expect_code(0).json();
    assert_eq!(status["machine"], "h4");
    assert_eq!(status["state"], "Run", "{status:#}");
    assert_eq!(status["homed"], true);
    let text = scene.ask(&["status"]).expect_code(0).out;
    assert!(text.starts_with("h4: running, homed: yes"), "{text}");
    assert!(text.contains("\nmeasured   x "), "{text}");
    // What commands is refused, as before.
    let refused = scene.ask(&["disable"]).expect_code(5);
    assert!(
        refused.err.contains("another host is connected"),
        "{}",
        refused.err
    );
    scene.ask(&["hold"]).expect_code(0);
    let held = |_| scene.ask(&["status", "--json"]).json()["state"] == "Hold";
    assert!((0..200).any(held));
    run.interrupt();
    run.end().expect_code(7);
    // Without the job the controller itself reports; it has the same values.
    let alone = scene.ask(&["status", "--json"]).expect_code(0).json();
    let keys = |status: &serde_json::Value| -> Vec<String> {
        status.as_object().unwrap().keys().cloned().collect()
    };
    assert_eq!(keys(&alone), keys(&status));
    for key in ["machine", "configuration_crc", "homed"] {
        assert_eq!(alone[key], status[key], "{key}");
    }
}

#[test]
fn a_second_process_holds_resumes_and_stops_a_job() {
    let scene = Scene::new();
    // Pauses that are skipped are no holds that are skipped.
    let mut run = scene.run(&["--skip-pauses"]);
    let refused = scene.ask(&["resume"]).expect_code(8);
    assert!(refused.err.contains("not held"), "{}", refused.err);
    scene.ask(&["hold"]).expect_code(0);
    std::thread::sleep(std::time::Duration::from_secs(10));
    assert!(run.runs(), "the job did not hold");
    scene.ask(&["resume"]).expect_code(0);
    std::thread::sleep(std::time::Duration::from_secs(1));
    let stopped = scene.ask(&["stop"]).expect_code(0);
    assert!(stopped.out.contains("past the host"), "{}", stopped.out);
    let ended = run.end();
    assert_ne!(ended.code, 0, "{ended:?}");
    let summary = scene.folder.summary("out");
    assert_eq!(summary["position_kept"], true);
    assert!(number(&summary, "duration_s") > 10.0, "{summary}");
}

#[test]
fn requests_without_a_job_and_outside_of_limits_are_refused() {
    let scene = Scene::new();
    let none = scene.ask(&["override", "--feed", "50"]).expect_code(5);
    assert!(
        none.err.contains("no process of this user runs a job"),
        "{}",
        none.err
    );
    let machine = scene.folder.machine_with("[spindle]\nmax_rpm = 6000\n");
    let mut run = scene.run(&["--machine", &machine]);
    let fast = scene.ask(&["override", "--spindle", "160"]).expect_code(8);
    assert!(
        fast.err
            .contains("S4000 of the program would be 6400 rev/min"),
        "{}",
        fast.err
    );
    scene.ask(&["override", "--spindle", "150"]).expect_code(0);
    run.interrupt();
    assert!(run.runs() || !run.errors().is_empty());
    run.end();
    let simulator = start(&["override", "--port", "sim"]).end().expect_code(5);
    assert!(simulator.err.contains("sim serve"), "{}", simulator.err);
}
