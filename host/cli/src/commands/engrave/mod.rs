//! `haptimill engrave`: from a drawing to a part program.

mod args;
mod cut;
pub mod thesis;

use super::{CliError, Exit, output};
use haptimill_client::{Error, Located};
use haptimill_engrave::drawing::{Drawing, LayerChoice, Problem};
use haptimill_engrave::gcode::{Rates, program};
use haptimill_engrave::geometry::Point;
use haptimill_engrave::job::{Job, Operation, Options, check_area, check_pocket, plan};
use haptimill_engrave::kurbo::Affine;
use haptimill_engrave::plate::PlateReport;
use haptimill_engrave::preview;
use haptimill_engrave::read::text::Font;
use haptimill_engrave::read::{ReadOptions, read};
use haptimill_engrave::times::{Speeds, Times};
use haptimill_engrave::toolpath::Lengths;
use haptimill_kinematics::descriptor::Role;
use haptimill_machine_file::{AxisLimits, MachineFile, input};
use std::path::Path;
use std::time::Instant;

pub use args::EngraveArgs;
use args::{OriginName, Place};

/// Largest drawing, bytes.
const DRAWING_BYTES: u64 = 512 << 20;

/// The machine of a job without --machine.
const ENGRAVER: (&str, &str) = (
    "machines/engraver.toml",
    include_str!("../../../../../machines/engraver.toml"),
);

/// The problems of a drawing as an error of the command.
fn refuse(file: &Path, exit: Exit, problems: &[Problem]) -> CliError {
    const SHOWN: usize = 20;
    let file = file.display().to_string();
    let mut lines: Vec<String> = problems
        .iter()
        .take(SHOWN)
        .map(|problem| format!("{file}: {problem}"))
        .collect();
    if problems.len() > SHOWN {
        lines.push(format!("{file}: and {} more", problems.len() - SHOWN));
    }
    let mut error = CliError::new(exit, lines.join("\n"));
    error.problems = problems
        .iter()
        .map(|problem| Located {
            file: file.clone(),
            line: problem.line,
            column: 1,
            message: problem.message.clone(),
            remedy: problem.remedy.clone(),
        })
        .collect();
    error
}

/// Reads and places the drawing.
fn load(args: &EngraveArgs) -> Result<Drawing, CliError> {
    let bad = |path: &Path, what: &dyn std::fmt::Display| {
        CliError::from(Error::in_file(path.display(), what))
    };
    let bytes =
        input::read(&args.drawing, DRAWING_BYTES).map_err(|what| bad(&args.drawing, &what))?;
    let font_bytes = match &args.font {
        None => None,
        Some(path) => Some(input::read(path, DRAWING_BYTES).map_err(|what| bad(path, &what))?),
    };
    let font = match (&font_bytes, &args.font) {
        (Some(bytes), Some(path)) => Some(Font::new(bytes).map_err(|what| bad(path, &what))?),
        _ => None,
    };
    let options = ReadOptions {
        unit_mm: args.unit,
        scale: Some(args.scale),
        font: font.as_ref(),
        skip_text: args.skip_text,
        moved: args.origin != OriginName::Drawing,
        ignore_clips: args.ignore_clips,
    };
    let refused = |problems: &[Problem]| refuse(&args.drawing, Exit::BadInput, problems);
    let mut drawing = read(&bytes, &options).map_err(|problem| refused(&[problem]))?;
    let choice = LayerChoice {
        only: args.layer.clone(),
        without: args.without_layer.clone(),
    };
    drawing
        .select_layers(&choice)
        .map_err(|problem| refused(&[problem]))?;
    if !drawing.problems.is_empty() {
        return Err(refused(&drawing.problems));
    }
    if let Some([low, high]) = drawing.bounds() {
        let from = match args.origin {
            OriginName::Drawing => [0.0; 2],
            OriginName::LowerLeft => low,
            OriginName::Centre => [
                f64::midpoint(low[0], high[0]),
                f64::midpoint(low[1], high[1]),
            ],
        };
        let Place(to) = args.at;
        if from != to {
            drawing.transform(Affine::translate((to[0] - from[0], to[1] - from[1])));
        }
    }
    Ok(drawing)
}

/// Limits of the coordinate of the machine with a role.
fn tool_axis(machine: &MachineFile, role: Role) -> Option<&AxisLimits> {
    let index = machine.config.model.descriptor().coordinate(role)?;
    machine.pose.get(index)
}

/// Area and rapid rate of the coordinates that move the tool along x and y.
fn area(machine: &MachineFile) -> Result<([Point; 2], f64), CliError> {
    let axes = [Role::ToolX, Role::ToolY].map(|role| tool_axis(machine, role));
    let [Some(x), Some(y)] = axes else {
        let what = format!(
            "{}: no coordinates move the tool along x and y",
            machine.file
        );
        return Err(CliError::new(Exit::BadInput, what));
    };
    Ok(([[x.low, y.low], [x.high, y.high]], x.rate.min(y.rate)))
}

/// Speeds of the job, which the machine reaches, and what is said about feeds that it does not.
/// `rapid` is the rate of lifted moves, mm/s.
fn speeds(machine: &MachineFile, args: &EngraveArgs, rapid: f64) -> (Speeds, Vec<String>) {
    let rise = tool_axis(machine, Role::ToolZ).map_or(rapid, |z| z.rate);
    let mut notices = Vec::new();
    let mut reached = |option: &str, asked: f64, max: f64, along: &str| {
        if asked / 60.0 > max + 1e-9 {
            notices.push(format!(
                "{option} {asked}: {} reaches {} mm/min along {along}; the times are those of that \
                 feed",
                machine.config.name,
                max * 60.0
            ));
        }
        (asked / 60.0).min(max)
    };
    let speeds = Speeds {
        feed: reached("--feed", args.feed, rapid, "x and y"),
        plunge: reached("--plunge", args.plunge, rise, "z"),
        rapid,
        rise,
        lift_mm: args.lift,
    };
    (speeds, notices)
}

/// Refuses a depth or a lift that the travel of z does not have. Z0 is the surface of the plate.
fn check_height(machine: &MachineFile, args: &EngraveArgs) -> Result<(), CliError> {
    let Some(z) = tool_axis(machine, Role::ToolZ) else {
        return Ok(());
    };
    let levels = [
        ("--depth", args.depth, -args.depth),
        ("--lift", args.lift, args.lift),
    ];
    match levels
        .iter()
        .find(|(.., level)| !(z.low..=z.high).contains(level))
    {
        None => Ok(()),
        Some((option, value, level)) => {
            let what = format!(
                "{option} {value}: Z{level} is outside of the travel of {}, {} to {} mm about the \
                 surface of the plate",
                machine.config.name, z.low, z.high
            );
            Err(CliError::new(Exit::Refused, what))
        }
    }
}

/// Writes the part program of a drawing.
///
/// # Errors
/// See [`Exit`].
pub fn run(args: EngraveArgs) -> Result<(), CliError> {
    args.check()?;
    args.keep_inputs()?;
    let machine = match &args.machine {
        Some(path) => MachineFile::load(path)?,
        None => MachineFile::parse(ENGRAVER.0, ENGRAVER.1)?,
    };
    let (area, rapid) = area(&machine)?;
    check_height(&machine, &args)?;
    let drawing = load(&args)?;
    if !args.json {
        print_notices(&args, &drawing.notices);
    }
    let begin = Instant::now();
    let refused = |problems: Vec<Problem>| refuse(&args.drawing, Exit::BadInput, &problems);
    let outside = format!("the area of {}", machine.config.name);
    let leaves = |problems: Vec<Problem>| refuse(&args.drawing, Exit::Refused, &problems);
    let (speeds, unreached) = speeds(&machine, &args, rapid);
    let options = Options {
        speeds,
        ..args.options()
    };
    if options.operation == Operation::Pocket {
        check_pocket(&drawing, options.tool_mm, area, &outside).map_err(leaves)?;
    }
    let mut job = plan(&drawing, &options).map_err(refused)?;
    job.notices.extend(unreached);
    let analysis_s = begin.elapsed().as_secs_f64();
    check_area(&job, &drawing, area, &outside).map_err(leaves)?;
    let lengths = job.toolpath.lengths([0.0; 2]);
    let rates = Rates {
        feed: args.feed,
        plunge: args.plunge,
        speed: args.speed,
        lift_mm: args.lift,
    };
    let name = args
        .drawing
        .file_name()
        .unwrap_or_default()
        .to_string_lossy();
    let title = [
        format!(
            "{name}: {} with a tool of {} mm, {} mm deep",
            args.operation.name(),
            args.tool,
            args.depth
        ),
        format!(
            "cut {:.1} mm, air {:.1} mm, {} lifts",
            lengths.cut_mm, lengths.air_mm, lengths.lifts
        ),
    ];
    let text = program(&job.toolpath, rates, [0.0; 2], &title);
    let out = args.out();
    output::save(&out, &text)?;
    let times = Times::of(&lengths, &speeds);
    let rows: Vec<preview::Row> = job
        .candidates
        .iter()
        .map(|one| {
            let Lengths { air_mm, lifts, .. } = one.lengths;
            let total = Times::of(&one.lengths, &speeds).total();
            (one.name.clone(), air_mm, lifts, total)
        })
        .collect();
    if let Some(path) = &args.preview {
        let page = preview::html(&title[0], &drawing, &job, &options, speeds, &rows);
        output::save(path, page)?;
    }
    if !args.json {
        print_text(&args, &drawing, &job, &lengths, &times, &rows, analysis_s);
    }
    let surface = if args.run {
        Some(cut::cut(&args, &machine, &drawing, &job.tabs)?)
    } else {
        None
    };
    if args.json {
        print_json(
            &args,
            &drawing,
            &job,
            &times,
            &rows,
            analysis_s,
            surface.as_ref(),
        );
    } else if let Some(cut) = &surface {
        print_surface(cut);
    }
    let Some(cut) = surface else { return Ok(()) };
    match cut.wrong() {
        Some(what) => Err(CliError::new(Exit::Fault, what).reported()),
        None => Ok(()),
    }
}

fn print_notices(args: &EngraveArgs, notices: &[String]) {
    for notice in notices {
        eprintln!("{}: {notice}", args.drawing.display());
    }
}

fn print_text(
    args: &EngraveArgs,
    drawing: &Drawing,
    job: &Job,
    lengths: &Lengths,
    times: &Times,
    rows: &[preview::Row],
    analysis_s: f64,
) {
    print_notices(args, &job.notices);
    print_line!(
        "{}: {} entities, {} paths",
        args.drawing.display(),
        drawing.entities.len(),
        drawing.paths.len()
    );
    print_line!(
        "{:<42} {:>12} {:>7} {:>10}",
        "order",
        "air mm",
        "lifts",
        "time s"
    );
    for (name, air_mm, lifts, time_s) in rows {
        print_line!("{name:<42} {air_mm:>12.3} {lifts:>7} {time_s:>10.1}");
    }
    let proven = if job.proven {
        ", proven to be the shortest order"
    } else {
        ""
    };
    print_line!(
        "cut {:.1} mm in {:.1} s, air {:.1} mm in {:.1} s, {} lifts in {:.1} s, {} links{proven}",
        lengths.cut_mm,
        times.cut,
        lengths.air_mm,
        times.air,
        lengths.lifts,
        times.lifts,
        job.links
    );
    print_line!(
        "total       {:.1} s, {:.1} s with the analysis of {analysis_s:.3} s",
        times.total(),
        times.total() + analysis_s
    );
    print_line!("program     {}", args.out().display());
    if let Some(path) = &args.preview {
        print_line!("preview     {}", path.display());
    }
}

fn print_surface(cut: &cut::Cut) {
    let PlateReport {
        band_mm,
        asked_mm2,
        unreachable_mm2,
        uncut_mm2,
        over_cut_mm2,
        ..
    } = cut.surface;
    print_line!(
        "surface     {asked_mm2:.1} mm2 asked for, {unreachable_mm2:.1} mm2 out of the tool's reach"
    );
    print_line!(
        "            {uncut_mm2:.2} mm2 uncut, {over_cut_mm2:.2} mm2 over-cut (beyond {band_mm:.3} \
         mm of the edges)"
    );
    if cut.surface.is_coarse() {
        print_line!(
            "            compared at points {:.3} mm apart, which is coarse for this tool: {:.0} mm2 were \
             compared; engrave a smaller part of the drawing to compare more",
            cut.surface.cell_mm,
            cut.surface.judged_mm2
        );
    }
    print_line!(
        "depth       {:.3} mm asked for; {:.3} least, {:.3} mean, {:.3} greatest",
        cut.surface.depth_mm,
        cut.surface.min_depth_mm,
        cut.surface.mean_depth_mm,
        cut.surface.max_depth_mm
    );
    print_line!("steps       {}", cut.lost());
}

fn print_json(
    args: &EngraveArgs,
    drawing: &Drawing,
    job: &Job,
    times: &Times,
    rows: &[preview::Row],
    analysis_s: f64,
    cut: Option<&cut::Cut>,
) {
    let lengths = job.toolpath.lengths([0.0; 2]);
    let orders: Vec<serde_json::Value> = job
        .candidates
        .iter()
        .zip(rows)
        .map(|(one, (.., time_s))| {
            let mut order = serde_json::json!(one);
            order["time_s"] = (*time_s).into();
            order
        })
        .collect();
    let value = serde_json::json!({
        "drawing": args.drawing.display().to_string(),
        "program": args.out().display().to_string(),
        "entities": drawing.entities.len(),
        "paths": drawing.paths.len(),
        "notices": drawing.notices.iter().chain(&job.notices).collect::<Vec<_>>(),
        "orders": orders,
        "proven": job.proven,
        "cut_mm": lengths.cut_mm,
        "air_mm": lengths.air_mm,
        "lifts": lengths.lifts,
        "links": job.links,
        "time_s": {
            "cut": times.cut,
            "air": times.air,
            "lifts": times.lifts,
            "total": times.total(),
            "analysis": analysis_s,
            "total_with_analysis": times.total() + analysis_s,
        },
        "surface": cut.map(|cut| &cut.surface),
        "surface_differs": cut.and_then(cut::Cut::differs),
        "off_mm": cut.map(|cut| cut.off_mm),
        "lost_at": cut.and_then(|cut| cut.lost_at).map(|(line, off_mm)| {
            serde_json::json!({ "line": line, "off_mm": off_mm })
        }),
    });
    print_line!("{value:#}");
}
