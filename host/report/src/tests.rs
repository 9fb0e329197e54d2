use super::*;
use haptimill_machine_file::MachineFile;

use haptimill_kinematics::{Joints, Kinematics, Pose};
use haptimill_math::Coordinate;
use haptimill_trace::{Header, Record, Recorder, flag};
use std::f64::consts::TAU;
use tempfile::{NamedTempFile, TempPath};

const MM: f64 = (1 << 20) as f64;
const PERIOD: f64 = 2e-4;

fn header() -> Header {
    Header::of(&MachineFile::built_in().unwrap(), "circle.ngc").unwrap()
}

/// A circle of 15 mm radius at 4 mm/s, the tool `outside` mm outside it and `late` seconds behind.
fn circle(outside: f64, late: f64) -> (TempPath, Recorded) {
    let file = NamedTempFile::new().unwrap().into_temp_path();
    let mut recorder = Recorder::create(&file, &header()).unwrap();
    let machine = MachineFile::built_in().unwrap().config.kinematics();
    let rate = 4.0 / 15.0;
    let periods = (TAU / rate / PERIOD) as u64;
    let fixed = |value: f64| (value * MM).round() as i32;
    let at = |time: f64, radius: f64| {
        let (sin, cos) = (rate * time).sin_cos();
        [-15.0 + radius * cos, -radius * sin, 21.232]
    };
    let joints = |point: [f64; 3]| {
        let mut pose = Pose::default();
        for (coordinate, value) in pose.0.iter_mut().zip(point) {
            *coordinate = Coordinate(fixed(value));
        }
        machine.inverse(&pose).unwrap()
    };
    let raw = |joints: Joints| joints.0.map(|joint| joint.0);
    let row = |point: [f64; 3]| [fixed(point[0]), fixed(point[1]), fixed(point[2]), 0, 0, 0];
    for index in 0..periods + 1000 {
        // 0.1 s of standstill before and after.
        let time = (index as f64 - 500.0).clamp(0.0, periods as f64) * PERIOD;
        let (commanded, actual) = (at(time, 15.0), at((time - late).max(0.0), 15.0 + outside));
        let (joints_commanded, joints_actual) = (raw(joints(commanded)), raw(joints(actual)));
        recorder.record(&Record {
            period: 77 + index,
            setpoint: (index / 500) as u32,
            line: 1 + (index / 50_000) as u32,
            speed_factor: haptimill_protocol::message::FULL_SPEED_FACTOR,
            spindle_rpm: 5000,
            state: State::Run,
            flags: flag::HOMED | flag::TOOL_TRUE | flag::PROGRAMMED,
            commanded: row(commanded),
            joints_commanded,
            joints: joints_actual,
            following_error: std::array::from_fn(|i| joints_commanded[i] - joints_actual[i]),
            drive: std::array::from_fn(|i| {
                if i < 4 {
                    (1000.0 * (time * (i as f64 + 1.0)).sin()) as i32
                } else {
                    0
                }
            }),
            tool: row(actual),
            programmed: row(commanded),
            ..Record::default()
        });
    }
    let recorded = recorder.finish().unwrap();
    (file, recorded)
}

fn outcome() -> JobOutcome {
    JobOutcome {
        setpoints: 236,
        underruns: 0,
        faults: Vec::new(),
        injected: Vec::new(),
        completed: true,
        final_state: Some(State::Idle),
        bytes_per_setpoint: 20.5,
        line_bytes_per_setpoint: 31.0,
        cut: None,
        spindle_rpm: None,
        recorded_part: None,
        position_kept: true,
    }
}

#[test]
fn a_circle_with_a_radius_error_has_this_error_everywhere() {
    let (file, recorded) = circle(0.01, 0.0);
    let recording = Recording::open(&file).unwrap();
    let (summary, statistics) = Summary::of(&recording, &recorded, &outcome()).unwrap();
    for error in [
        summary.tool_error_rms_mm,
        summary.tool_error_max_mm,
        summary.contour_error_rms_mm,
        summary.contour_error_max_mm,
    ] {
        assert!((error - 0.01).abs() < 5e-6, "{error} {summary:?}");
    }
    assert!(
        (summary.path_length_mm - 30.0 * TAU / 2.0).abs() < 1e-2,
        "{}",
        summary.path_length_mm
    );
    assert!(
        (summary.duration_s - (23.5619 + 0.2)).abs() < 1e-3,
        "{}",
        summary.duration_s
    );
    assert_eq!(statistics.contour_error.count, recording.records());
    assert!(summary.following_error_max_mm > 0.005 && summary.following_error_max_mm < 0.05);
    assert_eq!(summary.angle_error_max_deg, 0.0);
}

/// Degrees are not added to millimetres: a turn of the rotary coordinates has no length, and its
/// errors are errors of angles.
#[test]
fn a_turn_has_no_length() {
    let file = NamedTempFile::new().unwrap().into_temp_path();
    let mut recorder = Recorder::create(&file, &header()).unwrap();
    let degrees = |value: f64| (value * 4_294_967_296.0 / 360.0).round() as i32;
    for index in 0..1000 {
        let turn = f64::from(index) * 0.02;
        let row = |off: f64| [0, 0, 0, degrees(turn + off), degrees(-turn - off), 0];
        recorder.record(&Record {
            period: index as u64,
            state: State::Run,
            flags: flag::HOMED | flag::TOOL_TRUE | flag::PROGRAMMED,
            commanded: row(0.0),
            following_error: [0, 0, 0, 0, degrees(-0.25), 0],
            tool: row(0.5),
            programmed: row(0.0),
            ..Record::default()
        });
    }
    let recorded = recorder.finish().unwrap();
    let recording = Recording::open(&file).unwrap();
    let (summary, _) = Summary::of(&recording, &recorded, &outcome()).unwrap();
    assert_eq!(summary.path_length_mm, 0.0);
    assert_eq!(summary.tool_error_max_mm, 0.0);
    assert_eq!(summary.contour_error_max_mm, 0.0);
    assert!((summary.angle_error_max_deg - 0.5).abs() < 1e-6);
    let terminal = summary.terminal();
    assert!(
        terminal.contains("angle error of the tool: 0.500 deg largest"),
        "{terminal}"
    );
    assert_eq!(summary.following_error_max_mm, 0.0);
    assert!((summary.following_error_max_deg - 0.25).abs() < 1e-6);
    assert_eq!(summary.following_error_max_deg_joint, "alpha");
}

#[test]
fn a_tool_that_lags_has_no_contour_error() {
    let (file, recorded) = circle(0.0, 0.01);
    let recording = Recording::open(&file).unwrap();
    let (summary, _) = Summary::of(&recording, &recorded, &outcome()).unwrap();
    // 10 ms at 4 mm/s.
    assert!(
        (summary.tool_error_max_mm - 0.04).abs() < 1e-4,
        "{summary:?}"
    );
    assert!(summary.contour_error_max_mm < 1e-4, "{summary:?}");
}

#[test]
fn a_rounded_corner_is_a_contour_error() {
    // Along x to a corner, then along y; the tool moves straight from 0.2 mm before the corner to
    // 0.2 mm after it.
    let mut contour = Contour::default();
    let mut errors = Vec::new();
    for step in -4000..=4000 {
        let s = f64::from(step) * 1e-3;
        let programmed = if s < 0.0 {
            [s, 0.0, 0.0]
        } else {
            [0.0, s, 0.0]
        };
        let part = (s + 0.2) / 2.0;
        let tool = if s.abs() < 0.2 {
            [part - 0.2, part, 0.0]
        } else {
            programmed
        };
        errors.extend(contour.add(programmed, tool));
    }
    errors.extend(contour.finish());
    assert_eq!(errors.len(), 8001);
    let largest = errors.iter().copied().fold(0.0, f64::max);
    // The middle of the cut is 0.1 mm from both legs.
    assert!((largest - 0.1).abs() < 1e-6, "{largest}");
}

#[test]
fn the_report_is_small_complete_and_self_contained() {
    let (file, recorded) = circle(0.02, 0.002);
    let recording = Recording::open(&file).unwrap();
    let mut outcome = outcome();
    outcome
        .faults
        .push("following error of <l1> & more".to_string());
    let (summary, statistics) = Summary::of(&recording, &recorded, &outcome).unwrap();
    let mut page = Vec::new();
    write_html(&recording, &summary, &statistics, None, &mut page).unwrap();
    if let Ok(keep) = std::env::var("HAPTIMILL_KEEP_REPORT") {
        std::fs::write(keep, &page).unwrap();
    }
    assert!(page.len() < 2_000_000, "{} bytes", page.len());
    let page = String::from_utf8(page).unwrap();
    for part in ["http", "src=", "NaN", "inf,", "<script"] {
        assert!(!page.contains(part), "the page has {part}");
    }
    assert_eq!(page.matches("<svg").count(), page.matches("</svg>").count());
    // The last one is the spindle of this recording.
    assert_eq!(page.matches("<svg").count(), 9);
    assert!(page.contains("following error of &lt;l1&gt; &amp; more"));
    assert!(page.contains(&summary.trace_sha256));
}

#[test]
fn a_peak_of_one_period_stays_in_the_chart() {
    let mut columns = series::Columns::new(0.0, 3600.0);
    for index in 0..1_000_000 {
        let value = if index == 777_777 { 9.0 } else { 1.0 };
        columns.add(f64::from(index) * 0.0036, value);
    }
    assert_eq!(columns.largest(), 9.0);
    let points = columns.line().concat();
    assert!(points.len() < 1500);
    assert!(points.iter().any(|(_, value)| *value == 9.0));
}

#[test]
fn a_recording_without_a_job_makes_a_report() {
    let file = NamedTempFile::new().unwrap().into_temp_path();
    let recorded = {
        let mut recorder = Recorder::create(&file, &header()).unwrap();
        recorder.record(&Record::default());
        recorder.finish().unwrap()
    };
    let recording = Recording::open(&file).unwrap();
    let (summary, statistics) = Summary::of(&recording, &recorded, &JobOutcome::default()).unwrap();
    let json = serde_json::to_string(&summary).unwrap();
    assert!(!json.contains("null"), "{json}");
    write_html(&recording, &summary, &statistics, None, &mut Vec::new()).unwrap();
    assert!(summary.terminal().contains("unknown, the link"));
}

#[test]
fn the_terminal_summary_has_a_few_lines() {
    let (file, recorded) = circle(0.01, 0.0);
    let recording = Recording::open(&file).unwrap();
    let (summary, _) = Summary::of(&recording, &recorded, &outcome()).unwrap();
    insta::assert_snapshot!("terminal", summary.terminal());
}

#[test]
fn durations_are_rounded_as_a_whole() {
    for (seconds, text) in [
        (0.0, "0.00 s"),
        (59.25, "59.25 s"),
        (60.0, "1 min 00 s"),
        (119.7, "2 min 00 s"),
        (3599.4, "59 min 59 s"),
        (3599.7, "1 h 00 min"),
        (7199.0, "2 h 00 min"),
        (3600.0 + 29.0 * 60.0, "1 h 29 min"),
    ] {
        assert_eq!(super::duration(seconds), text);
    }
}

#[test]
fn sparse_reports_give_one_line_and_a_pause_gives_two() {
    let mut columns = series::Columns::new(0.0, 10.0);
    for index in (0..500).filter(|index| !(200..260).contains(index) && index % 7 != 3) {
        columns.add(f64::from(index) * 0.02, 1.0);
    }
    assert_eq!(columns.line().len(), 2);
}

/// A report states whether volumetric compensation was in effect, from the flag of each record; a
/// machine without error tables has no such line.
#[test]
fn the_report_states_the_compensation() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../machines/vmc3.toml");
    let plain = MachineFile::load(&path).unwrap();
    let zeros = haptimill_volumetric::errors::ErrorSet::default();
    let travel = std::array::from_fn(|axis| (plain.pose[axis].low, plain.pose[axis].high));
    let text = haptimill_volumetric::file::write(&zeros.tabulated(&travel, [8; 3]), "");
    let tables = plain.with_errors("zeros", &text, "wYbXZt").unwrap();
    let state = |machine: &MachineFile, compensated: fn(u32) -> bool| {
        let file = NamedTempFile::new().unwrap().into_temp_path();
        let header = Header::of(machine, "line.ngc").unwrap();
        let mut recorder = Recorder::create(&file, &header).unwrap();
        for index in 0..1000 {
            let of = |is: bool, flag: u8| if is { flag } else { 0 };
            recorder.record(&Record {
                period: u64::from(index),
                // The fade before the job does not count.
                flags: of(index >= 200, flag::PROGRAMMED)
                    | of(compensated(index), flag::COMPENSATED),
                ..Record::default()
            });
        }
        let recorded = recorder.finish().unwrap();
        let recording = Recording::open(&file).unwrap();
        let (summary, statistics) = Summary::of(&recording, &recorded, &outcome()).unwrap();
        let mut page = Vec::new();
        write_html(&recording, &summary, &statistics, None, &mut page).unwrap();
        let page = String::from_utf8(page).unwrap();
        let state = summary.volumetric_compensation.clone();
        assert_eq!(page.contains("Volumetric compensation"), state.is_some());
        let line = format!(
            "volumetric compensation: {}\n",
            state.clone().unwrap_or_default()
        );
        assert_eq!(summary.terminal().contains(&line), state.is_some());
        state
    };
    assert_eq!(state(&plain, |_| false), None);
    assert_eq!(state(&tables, |_| false).as_deref(), Some("off"));
    assert_eq!(state(&tables, |index| index >= 200).as_deref(), Some("on"));
    assert_eq!(
        state(&tables, |index| index >= 600).as_deref(),
        Some("on in 50.0 % of the control periods")
    );
}
