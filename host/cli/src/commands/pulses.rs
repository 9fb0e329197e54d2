//! `haptimill pulses`: checks captured step, direction and enable lines.

use super::output::{write_error, write_file};
use super::trace::open;
use super::{CliError, Exit};
use clap::Args;
use haptimill_client::Error;
use haptimill_firmware::config::Drive;
use haptimill_firmware::io::DriveCommand;
use haptimill_machine_file::input;
use haptimill_pulses::{
    AxisReport, AxisSignals, Capture, Clock, FaultKind, NANOSECOND, Planned, Report, Rules, SECOND,
    Signal, check, picture, pulses,
};
use haptimill_trace::Recording;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Write as _};
use std::path::{Path, PathBuf};

const LONG: &str = "\
Check the step, direction and enable lines of a board, captured as VCD by a logic analyser or by \
the emulator. Width, pause, direction set-up and hold of every pulse are compared with the drive's \
limits, and no pulse may begin while the drives are disabled. With --recording every edge is also \
compared with its time by the segments that the controller commanded, and the pulses are counted.

The lines of joint NAME are found as NAME_step and NAME_dir, and the enable line as enable \
(active high); --joint and --enable name others. The limits are those of the recording's \
configuration; the options replace them.

Exit code 0: no fault. Exit code 8: faults; the first ones are listed.";

/// Arguments of `haptimill pulses`.
#[derive(Debug, Clone, Args)]
#[command(about = "Check captured step and direction lines against a recording", long_about = LONG)]
pub struct PulsesArgs {
    /// The captured lines (VCD)
    #[arg(value_name = "VCD")]
    pub capture: PathBuf,
    /// The recording (recording.hmr) of the job on the same board, since its power-on
    #[arg(long, value_name = "RECORDING")]
    pub recording: Option<PathBuf>,
    /// Lines of a joint; may be repeated
    #[arg(long, value_name = "NAME=STEP,DIRECTION", value_parser = lines_of_joint)]
    pub joint: Vec<JointLines>,
    /// The enable line, active high
    #[arg(long, value_name = "LINE")]
    pub enable: Option<String>,
    /// Shortest high time of a pulse
    #[arg(long, value_name = "US", value_parser = microseconds)]
    pub width_us: Option<f64>,
    /// Shortest low time between two pulses
    #[arg(long, value_name = "US", value_parser = microseconds)]
    pub pause_us: Option<f64>,
    /// Shortest time from a change of the direction to a pulse
    #[arg(long, value_name = "US", value_parser = microseconds)]
    pub setup_us: Option<f64>,
    /// Shortest time from a pulse to a change of the direction
    #[arg(long, value_name = "US", value_parser = microseconds)]
    pub hold_us: Option<f64>,
    /// High time that the board makes, in ticks of the step clock; falling edges are then compared,
    /// too
    #[arg(long, value_name = "TICKS", requires = "recording")]
    pub width_ticks: Option<u32>,
    /// Largest distance of an edge from its time; for a logic analyser the time between two samples
    /// [default: two units of the file]
    #[arg(long, value_name = "NS", value_parser = microseconds, requires = "recording")]
    pub tolerance_ns: Option<f64>,
    /// Draw the lines into a file
    #[arg(long, value_name = "FILE")]
    pub svg: Option<PathBuf>,
    /// Start of the picture, seconds in the capture [default: the first pulse]
    #[arg(long, value_name = "SECONDS", requires = "svg", value_parser = microseconds)]
    pub from: Option<f64>,
    /// Duration of the picture
    #[arg(long, value_name = "US", requires = "svg", default_value_t = 200.0, value_parser = microseconds)]
    pub span_us: f64,
    /// Print the result as JSON on standard output, and nothing else there
    #[arg(long)]
    pub json: bool,
}

/// Lines of a joint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JointLines {
    name: String,
    step: String,
    direction: String,
}

/// Parses `NAME=STEP,DIRECTION`.
fn lines_of_joint(text: &str) -> Result<JointLines, String> {
    let parsed = text.split_once('=').and_then(|(name, lines)| {
        let (step, direction) = lines.split_once(',')?;
        let all = [name, step, direction].map(str::trim);
        all.iter().all(|part| !part.is_empty()).then_some(all)
    });
    match parsed {
        Some([name, step, direction]) => Ok(JointLines {
            name: name.into(),
            step: step.into(),
            direction: direction.into(),
        }),
        None => Err("write the joint and its lines as NAME=STEP,DIRECTION".to_string()),
    }
}

/// Parses a time, 0 or more.
fn microseconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.0..=9000.0 * 1e6).contains(&value) => Ok(value),
        _ => Err("write a number from 0 to 9e9".to_string()),
    }
}

fn bad(path: &Path, what: impl std::fmt::Display) -> CliError {
    Error::in_file(path.display(), what).into()
}

/// A joint of the check: its name, and its segments if there is a recording.
struct Joint {
    name: String,
    planned: Option<Vec<Planned>>,
}

/// Largest capture, bytes.
const MAX_BYTES: u64 = 4 << 30;

/// Opens a capture. A pipe is read to its end first, because it may have none.
fn open_capture(path: &Path) -> Result<Box<dyn BufRead>, CliError> {
    let cannot = |error: io::Error| bad(path, format!("cannot be read: {error}; check the path"));
    let kind = path.metadata().map_err(cannot)?;
    if !kind.is_file() {
        let bytes = input::read(path, input::TABLE_BYTES).map_err(|error| bad(path, error))?;
        return Ok(Box::new(io::Cursor::new(bytes)));
    }
    if kind.len() > MAX_BYTES {
        let gib = MAX_BYTES >> 30;
        return Err(bad(
            path,
            format!("it is larger than {gib} GiB; export a shorter part"),
        ));
    }
    let file = File::open(path).map_err(cannot)?;
    Ok(Box::new(BufReader::with_capacity(1 << 20, file)))
}

/// Checks a capture.
///
/// # Errors
/// See [`Exit`]; [`Exit::Command`] when there are faults.
pub fn run(args: &PulsesArgs) -> Result<(), CliError> {
    let capture = Capture::read_vcd(open_capture(&args.capture)?)
        .map_err(|error| bad(&args.capture, error))?;
    let mut rules = Rules {
        clock: Clock {
            ticks_per_us: 1,
            period_us: 1,
        },
        tolerance: 2 * capture.resolution,
        width: 0,
        pause: 0,
        setup: 0,
        hold: 0,
        exact_width: args.width_ticks,
    };
    let joints = match &args.recording {
        Some(path) => recorded(path, &mut rules)?,
        None => Vec::new(),
    };
    apply_options(args, &mut rules);
    let lines = find_lines(args, &capture, joints)?;
    let axes: Vec<_> = lines
        .iter()
        .map(|(joint, step, direction)| AxisSignals {
            name: &joint.name,
            step,
            direction,
            planned: joint.planned.as_deref(),
        })
        .collect();
    let enable = enable_line(args, &capture)?;
    let report = check(&capture, &axes, enable, &rules);
    if let Some(path) = &args.svg {
        draw(args, path, &axes, enable, &report, &rules)?;
    }
    if args.json {
        let text = serde_json::json!({
            "capture": args.capture.display().to_string(),
            "faults": report.fault_count(),
            "edges_compared": report.compared(),
            "tolerance_fs": rules.tolerance,
            "offset_fs": report.offset,
            "joints": report.axes,
        });
        print_line!("{text:#}");
    } else {
        print(args, &report, &rules);
    }
    match report.fault_count() {
        0 => Ok(()),
        count => Err(CliError::new(
            Exit::Command,
            format!("{}: {count} faults", args.capture.display()),
        )
        .reported()),
    }
}

/// Limits of the command line.
fn apply_options(args: &PulsesArgs, rules: &mut Rules) {
    let fs = |us: f64| (us * 1e9) as i64;
    for (option, limit) in [
        (args.width_us, &mut rules.width),
        (args.pause_us, &mut rules.pause),
        (args.setup_us, &mut rules.setup),
        (args.hold_us, &mut rules.hold),
    ] {
        if let Some(us) = option {
            *limit = fs(us);
        }
    }
    if let Some(ns) = args.tolerance_ns {
        rules.tolerance = rules.tolerance.max((ns * NANOSECOND as f64) as i64);
    }
}

/// Reads step clock, limits and segments of all step drives of a recording.
fn recorded(path: &Path, rules: &mut Rules) -> Result<Vec<Joint>, CliError> {
    let recording = open(path)?;
    if recording.periods() == 0 {
        return Err(bad(
            path,
            "has no control periods: a job behind a port records only telemetry, without the \
             commanded pulses",
        ));
    }
    let config = recording.config();
    let mut joints = Vec::new();
    let mut clock = None;
    for (axis, joint) in config.joints.iter().enumerate() {
        let Drive::Steps {
            ticks_per_us,
            pulse,
            setup,
            hold,
            ..
        } = joint.drive
        else {
            continue;
        };
        let own = Clock {
            ticks_per_us: u32::from(ticks_per_us),
            period_us: u32::from(config.period_us),
        };
        if *clock.get_or_insert(own) != own {
            return Err(bad(
                path,
                "the joints have different step clocks; one capture of a board has one",
            ));
        }
        rules.clock = own;
        let time = |ticks: u16| own.femtoseconds(i64::from(ticks));
        // `pulse` is the planner's width, and its least pause.
        rules.pause = rules.pause.max(time(pulse));
        rules.setup = rules.setup.max(time(setup));
        rules.hold = rules.hold.max(time(hold));
        let name = recording.header().joints.get(axis).cloned();
        joints.push((axis, name.unwrap_or_else(|| format!("joint{axis}"))));
    }
    if joints.is_empty() {
        return Err(bad(path, "the machine has no step drive"));
    }
    let segments = segments(&recording).map_err(|error| bad(path, error))?;
    let joints = joints.into_iter().map(|(axis, name)| Joint {
        name,
        planned: segments.get(axis).cloned(),
    });
    Ok(joints.collect())
}

/// Segments with steps, of all joints. Outputs take effect in the period after them; after missed
/// periods that is the next one which was not missed.
fn segments(recording: &Recording) -> Result<Vec<Vec<Planned>>, haptimill_trace::RecordingError> {
    let mut planned = vec![Vec::new(); recording.config().joints.len()];
    let mut periods = recording.read_periods()?;
    let Some(mut before) = periods.next().transpose()? else {
        return Ok(planned);
    };
    for period in periods {
        let period = period?;
        for (drive, planned) in before.outputs.joints.iter().zip(&mut planned) {
            if let DriveCommand::Steps(segment) = drive
                && segment.count != 0
            {
                planned.push(Planned {
                    period: period.inputs.period,
                    segment: *segment,
                });
            }
        }
        before = period;
    }
    Ok(planned)
}

/// Finds the lines of all joints.
fn find_lines<'a>(
    args: &PulsesArgs,
    capture: &'a Capture,
    joints: Vec<Joint>,
) -> Result<Vec<(Joint, &'a Signal, &'a Signal)>, CliError> {
    let find = |name: &str| capture.find(name).map_err(|what| bad(&args.capture, what));
    let mut given = args.joint.clone();
    let mut found = Vec::new();
    let has_recording = !joints.is_empty();
    for joint in joints {
        let lines = match given.iter().position(|lines| lines.name == joint.name) {
            Some(at) => given.remove(at),
            None => conventional(&joint.name),
        };
        found.push((joint, find(&lines.step)?, find(&lines.direction)?));
    }
    if has_recording && let Some(lines) = given.first() {
        return Err(CliError::new(
            Exit::Usage,
            format!("--joint: the recording has no step drive '{}'", lines.name),
        ));
    }
    if !has_recording && given.is_empty() {
        let names = capture.signals.iter().filter_map(|signal| {
            let name = signal.short_name().strip_suffix("_step")?;
            capture.find(&format!("{name}_dir")).ok()?;
            Some(conventional(name))
        });
        given = names.collect();
    }
    for lines in given {
        let (step, direction) = (find(&lines.step)?, find(&lines.direction)?);
        let joint = Joint {
            name: lines.name,
            planned: None,
        };
        found.push((joint, step, direction));
    }
    if found.is_empty() {
        return Err(bad(
            &args.capture,
            format!(
                "has no lines named NAME_step and NAME_dir; name them with --joint \
                 NAME=STEP,DIRECTION. There are {}",
                capture.names()
            ),
        ));
    }
    Ok(found)
}

fn conventional(name: &str) -> JointLines {
    JointLines {
        name: name.to_string(),
        step: format!("{name}_step"),
        direction: format!("{name}_dir"),
    }
}

fn enable_line<'a>(
    args: &PulsesArgs,
    capture: &'a Capture,
) -> Result<Option<&'a Signal>, CliError> {
    match &args.enable {
        Some(name) => match capture.find(name) {
            Ok(signal) => Ok(Some(signal)),
            Err(what) => Err(bad(&args.capture, what)),
        },
        None => Ok(capture.find("enable").ok()),
    }
}

/// Draws a part of the capture.
fn draw(
    args: &PulsesArgs,
    path: &Path,
    axes: &[AxisSignals<'_>],
    enable: Option<&Signal>,
    report: &Report,
    rules: &Rules,
) -> Result<(), CliError> {
    let first = axes
        .iter()
        .filter_map(|axis| axis.step.changes_to(true).next())
        .map(|(rise, _)| rise)
        .min()
        .unwrap_or(0);
    let from = args.from.map_or(first - 10_000 * NANOSECOND, |from| {
        (from * SECOND as f64) as i64
    });
    let to = from.saturating_add((args.span_us * 1e9) as i64);
    let mut signals: Vec<&Signal> = Vec::new();
    let mut marks = Vec::new();
    for axis in axes {
        let planned = pulses(axis.planned.unwrap_or_default(), rules.clock);
        let at = planned.iter().filter_map(|pulse| {
            let offset = report.offset?;
            Some(rules.clock.femtoseconds(pulse.tick) + offset)
        });
        signals.extend([axis.step, axis.direction]);
        marks.extend([at.collect(), Vec::new()]);
    }
    signals.extend(enable);
    let svg = picture(&signals, &marks, from, to)
        .map_err(|what| CliError::new(Exit::Usage, format!("--svg: {what}")))?;
    write_file(
        path,
        |error| write_error(path, error),
        |file| {
            file.write_all(svg.as_bytes())
                .map_err(|error| write_error(path, error))
        },
    )
}

/// Prints a report for people.
fn print(args: &PulsesArgs, report: &Report, rules: &Rules) {
    let ns = |fs: i64| fs as f64 / NANOSECOND as f64;
    let shortest = |time: Option<i64>| time.map_or("-".to_string(), |fs| format!("{:.1}", ns(fs)));
    for axis in &report.axes {
        let AxisReport { name, pulses, .. } = axis;
        print_line!(
            "{name}: {pulses} pulses, sum {}{}; shortest width {} ns, pause {} ns, set-up {} ns, \
             hold {} ns",
            axis.count,
            axis.commanded
                .map_or(String::new(), |sum| format!(" (commanded {sum})")),
            shortest(axis.shortest_width),
            shortest(axis.shortest_pause),
            shortest(axis.shortest_setup),
            shortest(axis.shortest_hold),
        );
        for fault in axis.faults.iter().take(10) {
            let amount = match fault.kind {
                FaultKind::Displaced => format!(", by {:.3} ns", ns(fault.amount)),
                FaultKind::Narrow | FaultKind::ShortPause | FaultKind::Setup | FaultKind::Hold => {
                    format!(" ({:.1} ns)", ns(fault.amount))
                }
                _ => String::new(),
            };
            let period = fault
                .period
                .map_or(String::new(), |period| format!(", control period {period}"));
            print_line!(
                "  {:.9} s{period}: {}{amount}",
                fault.time as f64 / SECOND as f64,
                fault.kind
            );
        }
        if axis.fault_count > 10 {
            print_line!("  {} faults in all", axis.fault_count);
        }
    }
    if args.recording.is_some() {
        print_line!(
            "{} edges compared, tolerance {:.3} ns, {} faults",
            report.compared(),
            ns(rules.tolerance),
            report.fault_count()
        );
    } else {
        print_line!(
            "{} faults. Without --recording no edge was compared with its commanded time.",
            report.fault_count()
        );
    }
    let unchecked: Vec<_> = [
        ("width", rules.width),
        ("pause", rules.pause),
        ("set-up", rules.setup),
        ("hold", rules.hold),
    ]
    .into_iter()
    .filter_map(|(name, limit)| (limit == 0).then_some(name))
    .collect();
    if !unchecked.is_empty() {
        print_line!(
            "Not compared with a limit: {} (options --width-us, --pause-us, --setup-us, --hold-us)",
            unchecked.join(", ")
        );
    }
}
