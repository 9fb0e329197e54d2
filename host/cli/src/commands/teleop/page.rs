//! The report page of a session: figures, holds, and charts of the table of reports and of the
//! recording of the machine.

use super::session::TABLE_FILE;
use haptimill_report::chart::{COLOURS, Chart, Line};
use haptimill_report::markup::{self, card, escape, put};
use haptimill_report::series::Columns;
use haptimill_report::{Cut, count, cut_surface, duration};
use haptimill_teleop::TeleopOutcome;
use haptimill_trace::{Column, Recording, RecordingError, columns};
use std::error::Error;
use std::path::Path;

/// A chart of columns of the table of reports.
struct Group {
    caption: &'static str,
    y_label: &'static str,
    /// Columns and their labels.
    lines: &'static [(&'static str, &'static str)],
}

const GROUPS: &[Group] = &[
    Group {
        caption: "Tip of the master, from where it began",
        y_label: "master, mm",
        lines: &[
            ("master_x_mm", "x"),
            ("master_y_mm", "y"),
            ("master_z_mm", "z"),
        ],
    },
    Group {
        caption: "Tool as measured, in the frame of the workpiece",
        y_label: "tool, mm",
        lines: &[("tool_x_mm", "x"), ("tool_y_mm", "y"), ("tool_z_mm", "z")],
    },
    Group {
        caption: "Orientation of the handle: components of the direction of its z axis",
        y_label: "direction",
        lines: &[
            ("master_axis_z_x", "x"),
            ("master_axis_z_y", "y"),
            ("master_axis_z_z", "z"),
        ],
    },
    Group {
        caption: "Force on the tool: the peak of the last revolution of the spindle",
        y_label: "force, N",
        lines: &[("force_x_n", "x"), ("force_y_n", "y"), ("force_z_n", "z")],
    },
    Group {
        caption: "Force of the master on the operator",
        y_label: "force, N",
        lines: &[
            ("feedback_x_n", "x"),
            ("feedback_y_n", "y"),
            ("feedback_z_n", "z"),
        ],
    },
    Group {
        caption: "Age of the newest master sample, and whether the enabling switch is pressed (1)",
        y_label: "ms",
        lines: &[
            ("age_ms", "age, ms"),
            ("enabling_switch", "enabling switch"),
        ],
    },
];

/// A chart over time.
fn chart(y_label: &str, lines: Vec<Line>) -> String {
    let chart = Chart {
        x_label: "time, s".into(),
        y_label: y_label.into(),
        lines,
        width: 1120.0,
        height: 290.0,
        equal: false,
        from_zero: false,
        backdrop: None,
    };
    chart.svg()
}

fn line(label: &str, index: usize, series: &Columns) -> Line {
    Line {
        label: label.to_string(),
        colour: COLOURS[index % COLOURS.len()],
        width: 1.3,
        pieces: series.line(),
    }
}

/// Makes the page of the session whose files are in a folder.
///
/// # Errors
/// A file of the folder cannot be read.
pub(super) fn page(
    dir: &Path,
    machine: &str,
    outcome: &TeleopOutcome,
    joints: &JointErrors,
    cut: Option<&Cut>,
) -> Result<String, Box<dyn Error>> {
    let mut page = markup::head(&format!("teleoperation, {machine}"), "");
    put(
        &mut page,
        format_args!(
            "<h1>Teleoperation</h1><p class=\"sub\">{}, {}</p>",
            escape(machine),
            duration(outcome.duration_s)
        ),
    );
    tiles(&mut page, outcome, joints.spindle_rpm, cut);
    lists(&mut page, outcome);
    page.push_str("<h2>Master and tool</h2>");
    let (groups, path) = table_lines(dir, outcome)?;
    for (group, lines) in GROUPS.iter().zip(groups) {
        card(&mut page, group.caption, &chart(group.y_label, lines));
    }
    if let Some(cut) = cut {
        cut_surface(&mut page, cut, path);
    }
    page.push_str("<h2>Joints of the machine</h2>");
    for (unit, lines) in joints.lines() {
        let caption = "Following error: commanded minus measured position";
        card(&mut page, caption, &chart(&format!("error, {unit}"), lines));
    }
    page.push_str(markup::END);
    Ok(page)
}

fn tiles(page: &mut String, outcome: &TeleopOutcome, spindle_rpm: u16, cut: Option<&Cut>) {
    let size = |force: &[f64; 3]| force.iter().fold(0.0_f64, |max, part| max.max(*part));
    let latency = outcome.latency.as_ref();
    let tiles = [
        (duration(outcome.duration_s), "duration"),
        (outcome.samples_sent.to_string(), "master samples"),
        (
            format!("{:.2} N", size(&outcome.largest_force_n)),
            "largest force on the tool along an axis",
        ),
        (
            format!("{:.2} N", size(&outcome.largest_feedback_n)),
            "largest force on the operator along an axis",
        ),
        (
            latency.map_or("-".to_string(), |it| format!("{:.1} ms", it.median_ms)),
            "latency of the force feedback, median",
        ),
        (
            latency.map_or("-".to_string(), |it| format!("{:.1} ms", it.p95_ms)),
            "latency, 95th percentile",
        ),
        (
            format!(
                "{:.1} / {:.1} ms",
                outcome.machine_round_trip_ms, outcome.master_round_trip_ms
            ),
            "round trip to the machine / to the master",
        ),
        (count(outcome.holds.len(), "hold"), "of the machine"),
    ];
    let mut tiles = tiles.to_vec();
    if let Some(cut) = cut {
        tiles.push((format!("{:.1} mm^3", cut.removed_mm3), "removed"));
        tiles.push((
            format!("{:.2} mm", cut.depth_mm),
            "depth of the cut, largest",
        ));
    }
    if spindle_rpm > 0 {
        tiles.push((format!("{spindle_rpm} rev/min"), "spindle, largest"));
    }
    page.push_str("<div class=\"tiles\">");
    for (value, label) in tiles {
        let value = escape(&value);
        put(
            page,
            format_args!("<div class=\"tile\"><b>{value}</b><span>{label}</span></div>"),
        );
    }
    page.push_str("</div>");
}

/// How it ended, faults, holds, refused commands, notes.
fn lists(page: &mut String, outcome: &TeleopOutcome) {
    let kept = if outcome.position_kept {
        "position kept"
    } else {
        "position lost"
    };
    let mut end = vec![format!("{}, {kept}", outcome.final_state_text)];
    end.extend(outcome.because.clone());
    let holds = outcome.holds.iter().map(|hold| {
        let resumed = hold.resumed_s.map_or("not resumed".to_string(), |at| {
            format!("resumed at {at:.2} s")
        });
        format!("{:.2} s: {}; {resumed}", hold.at_s, hold.why)
    });
    for (title, class, lines) in [
        ("End", "card", end),
        ("Faults", "card bad", outcome.faults.clone()),
        ("Holds", "card", holds.collect()),
        ("Refused commands", "card", outcome.refused.clone()),
        ("Notes", "card", outcome.notes.clone()),
    ] {
        if lines.is_empty() {
            continue;
        }
        put(
            page,
            format_args!("<h2>{title}</h2><div class=\"{class}\">"),
        );
        for text in lines {
            put(page, format_args!("<p>{}</p>", escape(&text)));
        }
        page.push_str("</div>");
    }
}

/// The lines of [`GROUPS`], and the path of the tool from above, from the table of reports.
#[allow(clippy::type_complexity, reason = "two results of one pass")]
fn table_lines(
    dir: &Path,
    outcome: &TeleopOutcome,
) -> Result<(Vec<Vec<Line>>, Vec<(f64, f64)>), Box<dyn Error>> {
    let mut reader = csv::Reader::from_path(dir.join(TABLE_FILE))?;
    let names = reader.headers()?.clone();
    let place = |name: &str| {
        let found = names.iter().position(|known| known == name);
        found.ok_or_else(|| format!("{TABLE_FILE} has no column {name}"))
    };
    let end = outcome.duration_s.max(1e-3);
    let mut groups = Vec::new();
    for group in GROUPS {
        let places = group.lines.iter().map(|(name, _)| place(name));
        let places = places.collect::<Result<Vec<_>, _>>()?;
        let series = places.into_iter().map(|at| (at, Columns::new(0.0, end)));
        groups.push(series.collect::<Vec<_>>());
    }
    let mut row = csv::StringRecord::new();
    // The tip of the master is far from the origin of its base.
    let mut begun = vec![None; names.len()];
    let (tool_x, tool_y) = (place("tool_x_mm")?, place("tool_y_mm")?);
    let mut path = Vec::new();
    let is_tip = |at: usize| names[at].starts_with("master_") && names[at].ends_with("_mm");
    while reader.read_record(&mut row)? {
        let value = |at: usize| row.get(at).and_then(|text| text.parse::<f64>().ok());
        let Some(time_s) = value(0) else { continue };
        // A point where the tool moved by more than 0.02 mm: a chart has no finer line.
        if let (Some(x), Some(y)) = (value(tool_x), value(tool_y))
            && path
                .last()
                .is_none_or(|last: &(f64, f64)| (x - last.0).hypot(y - last.1) > 0.02)
        {
            path.push((x, y));
        }
        for (at, series) in groups.iter_mut().flatten() {
            if let Some(value) = value(*at) {
                let begin = *begun[*at].get_or_insert(value);
                series.add(time_s, if is_tip(*at) { value - begin } else { value });
            }
        }
    }
    let lines = GROUPS.iter().zip(groups).map(|(group, series)| {
        let labels = group.lines.iter().zip(series).enumerate();
        let lines = labels.map(|(index, ((_, label), (_, series)))| line(label, index, &series));
        lines.collect()
    });
    Ok((lines.collect(), path))
}

/// Following errors of the joints, and the greatest spindle speed, from the recording.
pub(super) struct JointErrors {
    errors: Vec<(Column, Columns)>,
    /// Either direction, rev/min.
    pub(super) spindle_rpm: u16,
}

impl JointErrors {
    pub(super) fn read(file: &Path) -> Result<Self, RecordingError> {
        let recording = Recording::open(file)?;
        let mut read = Self {
            errors: Vec::new(),
            spindle_rpm: 0,
        };
        let Some(first) = recording.iter()?.next().transpose()? else {
            return Ok(read);
        };
        let last = recording.last()?.map_or(first.period, |last| last.period);
        let seconds =
            |period: u64| period.saturating_sub(first.period) as f64 * recording.period_s();
        let end = seconds(last).max(1e-3);
        let errors = columns(&recording).into_iter();
        read.errors = errors
            .filter(|column| column.group == "joint_error")
            .map(|column| (column, Columns::new(0.0, end)))
            .collect();
        for record in recording.iter()? {
            let record = record?;
            let time_s = seconds(record.period);
            read.spindle_rpm = read.spindle_rpm.max(record.spindle_rpm.unsigned_abs());
            for (column, series) in &mut read.errors {
                if let Some(value) = column.value(&record, time_s) {
                    series.add(time_s, value.number());
                }
            }
        }
        Ok(read)
    }

    /// Lines with their unit: linear and rotary joints apart.
    fn lines(&self) -> Vec<(&'static str, Vec<Line>)> {
        let mut groups = Vec::new();
        for unit in ["mm", "deg"] {
            let of_unit = self.errors.iter().filter(|(column, _)| column.unit == unit);
            let lines: Vec<Line> = of_unit
                .enumerate()
                .map(|(index, (column, series))| line(&column.name, index, series))
                .collect();
            if !lines.is_empty() {
                groups.push((unit, lines));
            }
        }
        groups
    }
}
