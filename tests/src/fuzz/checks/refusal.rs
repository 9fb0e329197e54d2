//! Refused commands: nothing changes at standstill.

use super::super::bench::FuzzBench;
use haptimill_protocol::message::State;

/// Returns everything that a refused command must not change, in lines.
#[must_use]
pub fn fingerprint(bench: &FuzzBench) -> String {
    let controller = bench.controller();
    let safety = controller.safety();
    let mut text = format!(
        "state {:?} fault {:?} homed {}\n",
        safety.state(),
        safety.fault(),
        safety.homed()
    );
    let all = without_power_on(&format!("{controller:?}"));
    if let Some(at) = all.rfind("job: Job {") {
        let changing = [
            "since_out_of_band_stop",
            "digest_backlog",
            "busy",
            "missed",
            "stale_commands",
        ];
        for field in all[at..].split(", ") {
            if !changing.iter().any(|name| field.starts_with(name)) {
                text.push_str(field);
                text.push('\n');
            }
        }
    }
    if let Some(machine) = controller.machine() {
        text.push_str(&format!(
            "crc {} commanded {:?}\n",
            machine.crc,
            machine.motion.commanded()
        ));
        for field in format!("{:?}", machine.motion).split(", ") {
            // A countdown: a source that waits for the others to leave it room.
            if !field.starts_with("retry_in") {
                text.push_str(field);
                text.push('\n');
            }
        }
        if let Some(force) = &machine.force {
            text.push_str(&format!(
                "force {} {} {:?}\n",
                force.mask(),
                force.conditioner().tared(),
                [0, 1, 2].map(|axis| force.settings(axis).cloned())
            ));
        }
    }
    text
}

/// Returns the text of a controller without its counts since power-on, which are inputs: joints may
/// be moved by hand before the first configuration.
fn without_power_on(controller: &str) -> String {
    let name = "power_on: SincePowerOn {";
    let start = controller.find(name).expect("the counts since power-on");
    let (before, counts) = controller.split_at(start + name.len());
    let mut depth = 1;
    let end = counts.find(|letter| {
        depth += match letter {
            '{' => 1,
            '}' => -1,
            _ => 0,
        };
        depth == 0
    });
    [before, &counts[end.expect("the closing brace")..]].concat()
}

/// Returns whether the controller is at standstill, so that its fingerprint is constant.
#[must_use]
pub fn is_at_standstill(bench: &FuzzBench) -> bool {
    let controller = bench.controller();
    let state = controller.safety().state();
    let machine = controller.machine();
    // A compliant displacement that decays moves the tool, and a tare changes the sensor.
    if !machine
        .and_then(|machine| machine.force.as_ref())
        .is_none_or(|force| force.is_inactive() && !force.conditioner().taring())
    {
        return false;
    }
    matches!(
        state,
        State::Idle | State::Disabled | State::Fault | State::EmergencyStop
    ) || (state == State::Hold
        && controller
            .machine()
            .is_some_and(|machine| machine.motion.is_at_standstill()))
}

/// Returns the first line in which two fingerprints differ.
#[must_use]
pub fn difference(before: &str, after: &str) -> Option<String> {
    before
        .lines()
        .zip(after.lines())
        .find(|(a, b)| a != b)
        .map(|(a, b)| format!("{a} became {b}"))
}
