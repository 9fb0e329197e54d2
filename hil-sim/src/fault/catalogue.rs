//! Catalogue of all faults: names, keys and descriptions.

/// Catalogue entry of a fault.
pub(super) struct Entry {
    pub(super) name: &'static str,
    /// Keys of the fault, optional ones in brackets.
    pub(super) keys: &'static str,
    /// Description of the fault.
    pub(super) what: &'static str,
}

impl Entry {
    /// Usage line.
    pub(super) fn usage(&self) -> String {
        let blank = if self.keys.is_empty() { "" } else { " " };
        format!(
            "write {}{blank}{} [at=TIME] [for=TIME]",
            self.name, self.keys
        )
    }
}

const fn entry(name: &'static str, keys: &'static str, what: &'static str) -> Entry {
    Entry { name, keys, what }
}

/// All faults.
pub(super) const CATALOGUE: [Entry; 36] = [
    entry(
        "encoder-stuck",
        "joint=NAME channel=a|b level=low|high",
        "a channel of an encoder is stuck",
    ),
    entry(
        "encoder-swapped",
        "joint=NAME",
        "the channels of an encoder are swapped: it counts backwards",
    ),
    entry(
        "encoder-slip",
        "joint=NAME counts=N",
        "an encoder gains N counts, once",
    ),
    entry(
        "encoder-noise",
        "joint=NAME per-second=N",
        "noise pulses on the channels of an encoder",
    ),
    entry("index-missing", "joint=NAME", "the index line is open"),
    entry(
        "drive-dead",
        "joint=NAME",
        "the drive has no output and reports no fault",
    ),
    entry(
        "drive-tripped",
        "joint=NAME",
        "the drive has no output and reports a fault",
    ),
    entry(
        "drive-weak",
        "joint=NAME gain=X",
        "the drive's output is X times the command",
    ),
    entry(
        "drive-reversed",
        "joint=NAME",
        "the drive's output has the wrong sign",
    ),
    entry(
        "joint-jammed",
        "joint=NAME [effort=X]",
        "additional friction of X N (or N m); the joint is blocked without X",
    ),
    entry(
        "push",
        "joint=NAME effort=X",
        "an external force of X N (or N m) on the joint",
    ),
    entry(
        "switch-stuck",
        "joint=NAME switch=home|limit-low|limit-high active=yes|no",
        "a switch is stuck",
    ),
    entry(
        "switch-inverted",
        "joint=NAME switch=home|limit-low|limit-high",
        "a switch is inverted: active and inactive are exchanged",
    ),
    entry(
        "switch-missing",
        "joint=NAME switch=home|limit-low|limit-high",
        "a switch is not connected: its line is low",
    ),
    entry(
        "switch-bounces",
        "joint=NAME switch=home|limit-low|limit-high ms=X",
        "the contact of a switch bounces for X ms after a change",
    ),
    entry(
        "sensor-stuck",
        "along=x|y|z",
        "the force sensor repeats one code",
    ),
    entry(
        "sensor-dropped",
        "along=x|y|z",
        "the force sensor's signal is lost: codes of 0",
    ),
    entry(
        "sensor-reversed",
        "along=x|y|z",
        "the force sensor has the wrong sign",
    ),
    entry(
        "sensor-drift",
        "along=x|y|z rate=X",
        "the force sensor drifts by X N/s",
    ),
    entry(
        "sensor-saturated",
        "along=x|y|z level=low|high",
        "the force sensor is saturated",
    ),
    entry(
        "haptic-encoder-stuck",
        "leg=N sensor=slide|turn|hinge channel=a|b level=low|high",
        "a channel of an encoder of the haptic arm is stuck",
    ),
    entry(
        "haptic-encoder-swapped",
        "leg=N sensor=slide|turn|hinge",
        "the channels of an encoder of the haptic arm are swapped",
    ),
    entry(
        "haptic-encoder-slip",
        "leg=N sensor=slide|turn|hinge counts=N",
        "an encoder of the haptic arm gains N counts, once",
    ),
    entry(
        "haptic-encoder-dropped",
        "leg=N sensor=slide|turn|hinge",
        "an encoder of the haptic arm is disconnected",
    ),
    entry(
        "haptic-encoder-noise",
        "leg=N sensor=slide|turn|hinge per-second=N",
        "noise pulses on the channels of an encoder of the haptic arm",
    ),
    entry(
        "haptic-amplifiers-tripped",
        "",
        "the amplifiers of the haptic arm have no output and report a fault",
    ),
    entry("spindle-stalled", "", "the spindle does not turn"),
    entry(
        "input-level",
        "name=NAME level=low|high",
        "a digital input of [[plant.input]] is forced to a level",
    ),
    entry(
        "input-bounce",
        "name=NAME hz=X",
        "the level of a digital input alternates X times a second",
    ),
    entry("emergency-stop", "", "the emergency stop circuit is open"),
    entry(
        "missed-periods",
        "count=N",
        "the controller is not called for N periods, once",
    ),
    entry(
        "link-errors",
        "rate=X [direction=both|to-machine|to-host]",
        "bits are flipped, each with probability X",
    ),
    entry(
        "link-drop",
        "rate=X [direction=...]",
        "bytes are lost, each with probability X",
    ),
    entry(
        "link-duplicate",
        "rate=X [direction=...]",
        "bytes are duplicated, each with probability X",
    ),
    entry(
        "link-delay",
        "ms=X [direction=...]",
        "bytes arrive X milliseconds later",
    ),
    entry("link-cut", "[direction=...]", "all bytes are lost"),
];

/// Help text of all faults: a usage line for each, and an indented line that explains it.
pub fn catalogue() -> String {
    CATALOGUE
        .iter()
        .map(|entry| {
            let keys = format!("{} {}", entry.name, entry.keys);
            format!("  {}\n      {}\n", keys.trim_end(), entry.what)
        })
        .collect()
}
