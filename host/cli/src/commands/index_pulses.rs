//! `haptimill identify --index`: positions of the index pulses and their slack.

use super::identify_args::{IdentifyArgs, finish, folder, options, save, say};
use super::{CliError, Exit};
use haptimill_client::session::{Line, Session, find_home_pose};
use haptimill_identify::index_pulses::{
    IndexJoint, IndexPulses, IndexTest, TIMES, UNKNOWN, index_joints,
};
use haptimill_identify::switch_test::Skipped;
use haptimill_identify::{edit, page, record};
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::model::Model;
use haptimill_machine_file::scale::per_unit;
use serde_json::{Value, json};

/// The joints whose index pulses are sought, and the others with their reasons.
///
/// # Errors
/// No joint has an index pulse that can be sought.
pub(super) fn plan(
    args: &IdentifyArgs,
    machine: &MachineFile,
    is_chosen: &dyn Fn(&str) -> bool,
) -> Result<(Vec<IndexJoint>, Vec<Skipped>), CliError> {
    let (mut indexed, mut skipped) = index_joints(machine, args.travel);
    indexed.retain(|it| is_chosen(&machine.joints[it.joint].name));
    skipped.retain(|it| is_chosen(&it.name));
    if indexed.is_empty() {
        let reasons = skipped.iter();
        let reasons: Vec<String> = reasons
            .map(|it| format!("joint {}: {}", it.name, it.reason))
            .collect();
        return Err(CliError::new(Exit::BadInput, reasons.join("\n")));
    }
    Ok((indexed, skipped))
}

/// The range in which a joint is searched, as a line of text.
///
/// # Errors
/// The machine has no home pose.
pub(super) fn range(machine: &MachineFile, joint: &IndexJoint) -> Result<String, CliError> {
    let model = Model::new(machine);
    let home = model.to_engineering_units(&find_home_pose(machine, &model)?);
    let mut home = home.get(joint.coordinate).copied().unwrap_or_default();
    let mut axis = &machine.pose[joint.coordinate];
    let own = &machine.joints[joint.joint];
    // A linear joint of a rotary coordinate is searched at the rate of that coordinate.
    if axis.kind.is_rotary() != own.kind.is_rotary() {
        let preset = machine.config.joints[joint.joint].preset.0;
        (axis, home) = (own, f64::from(preset) / per_unit(own.kind));
    }
    let unit = if axis.kind.is_rotary() { "deg" } else { "mm" };
    Ok(format!(
        "  joint {}: {} {:.1} to {:.1} {unit}, {} searches for its index pulse at the rate of \
         homing",
        machine.joints[joint.joint].name,
        axis.name,
        (home - joint.reach).max(axis.low),
        (home + joint.reach).min(axis.high),
        2 * TIMES
    ))
}

/// Measures the joints.
pub(super) fn measure<L: Line>(
    args: &IdentifyArgs,
    machine: &MachineFile,
    session: &mut Session<L>,
    (joints, skipped): (&[IndexJoint], &[Skipped]),
) -> Result<(), CliError> {
    session.enable()?;
    let line_rate = options(args).line_rate;
    let mut test = IndexTest::new(session, machine, joints, line_rate)?;
    // The drives are off afterwards, also after an error.
    let found = test.measure(&mut |what| say(args, what))?;
    for joint in &found {
        say(args, &joint.summary());
    }
    say(args, UNKNOWN);
    let date = record::today();
    let name = machine.config.name.as_str();
    let folder = folder(args.out.as_ref(), machine);
    // The measurement first: the machine file may refuse the new values.
    let data = folder.join("index.toml");
    save(&data, &record::write_index_pulses(name, &date, &found))?;
    let (text, changes) = edit::with_index_pulses(machine, &found, &date)?;
    let html = folder.join("index.html");
    let shown = page::index_pulses(name, &date, &found, skipped, &changes);
    save(&html, &shown)?;
    if !args.json {
        print_line!("data        {}", data.display());
        print_line!("page        {}", html.display());
    }
    let skipped = skipped.iter();
    let skipped = skipped.map(|it| json!({ "name": it.name, "reason": it.reason }));
    let value = json!({
        "machine": name,
        "date": date,
        "index_pulses": found.iter().map(joint_json).collect::<Vec<_>>(),
        "not_measured": skipped.collect::<Vec<_>>(),
        "data": data,
        "page": html,
    });
    finish(args, machine, value, (&text, &changes), &date)
}

/// A joint as JSON; mm or degrees, and counts.
fn joint_json(joint: &IndexPulses) -> Value {
    let places = |upwards: bool| -> Vec<f64> {
        let passes = joint.passes.iter().filter(|it| it.upwards == upwards);
        passes.map(|it| it.at).collect()
    };
    json!({
        "name": joint.name,
        "index": joint.place(),
        "before": joint.before,
        "from_presets": joint.from_presets,
        "upwards": places(true),
        "downwards": places(false),
        "spread_counts": joint.spread(),
        "slack_counts": joint.slack(),
    })
}
