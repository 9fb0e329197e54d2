//! Answers in the Grbl dialect.

use haptimill_firmware::config::AxisKind;
use haptimill_gcode::{Dialog, PerLetter, SYSTEM_NAMES};
use haptimill_machine_file::MachineFile;
use std::fmt::Write as _;

/// What a controller says when it starts.
pub(super) const BANNER: &str = "Grbl 1.1h ['$' for help]";

/// Answer to `$`.
pub(super) const HELP: &str = "[HLP:$$ $# $G $I $N $C $X $H $J=line ~ ! ? ctrl-x]";

/// Answers to `$I`.
pub(super) const BUILD: [&str; 2] = ["[VER:1.1h.20190830:]", "[OPT:VH,15,128]"];

/// Numbers of errors.
pub(super) mod error {
    /// A `$` command that does not exist.
    pub(in super::super) const STATEMENT: u8 = 3;
    /// Only while nothing moves.
    pub(in super::super) const NOT_IDLE: u8 = 8;
    /// Not homed, or a fault is latched.
    pub(in super::super) const LOCKED: u8 = 9;
    /// The line is too long.
    pub(in super::super) const OVERFLOW: u8 = 11;
    /// A jog beyond a limit.
    pub(in super::super) const TRAVEL: u8 = 15;
    /// A jog with words that it cannot have.
    pub(in super::super) const BAD_JOG: u8 = 16;
    /// A block that cannot be run; the message says why.
    pub(in super::super) const BLOCK: u8 = 20;
    /// No feed.
    pub(in super::super) const FEED: u8 = 22;
    /// A value that cannot be written.
    pub(in super::super) const SETTING: u8 = 5;
}

/// Numbers of alarms.
pub(super) mod alarm {
    /// A fault: the drives are off, or the position may be lost.
    pub(in super::super) const FAULT: u8 = 1;
    /// A motion beyond a limit; the position is kept.
    pub(in super::super) const LIMIT: u8 = 2;
    /// Homing failed.
    pub(in super::super) const HOMING: u8 = 9;
}

/// Indices of X, Y, Z in the pose; `None` where the machine has none.
pub(super) fn axes(machine: &MachineFile) -> [Option<usize>; 3] {
    let described = machine.config.model.descriptor().pose;
    ['X', 'Y', 'Z'].map(|letter| described.iter().position(|axis| axis.letter == letter))
}

/// Coordinates of X, Y, Z; 0 where the machine has none.
pub(super) fn xyz(axes: [Option<usize>; 3], pose: &[f64]) -> [f64; 3] {
    axes.map(|index| {
        index
            .and_then(|index| pose.get(index))
            .copied()
            .unwrap_or(0.0)
    })
}

/// `1.000,2.000,3.000`, without minus zero.
pub(super) fn triple(values: [f64; 3]) -> String {
    values
        .map(|value| format!("{:.3}", value + 0.0))
        .map(|text| {
            if text == "-0.000" {
                "0.000".into()
            } else {
                text
            }
        })
        .join(",")
}

/// What `?` reports.
#[derive(Debug, Clone)]
pub(super) struct Status {
    pub(super) state: &'static str,
    pub(super) machine: [f64; 3],
    /// Machine coordinates of the origin of the work coordinates.
    pub(super) offset: [f64; 3],
    pub(super) feed_mm_min: f64,
    pub(super) spindle_rpm: i16,
    pub(super) coolant: (bool, bool),
    pub(super) overrides: [u8; 3],
    /// Blocks and bytes that may be sent.
    pub(super) room: bool,
}

impl Status {
    pub(super) fn text(&self) -> String {
        let [feed, rapid, spindle] = self.overrides;
        let mut text = format!(
            "<{}|MPos:{}|Bf:{},128|FS:{:.0},{}|WCO:{}|Ov:{feed},{rapid},{spindle}",
            self.state,
            triple(self.machine),
            if self.room { 15 } else { 0 },
            self.feed_mm_min,
            self.spindle_rpm.unsigned_abs(),
            triple(self.offset),
        );
        let mut accessories = String::new();
        match self.spindle_rpm {
            1.. => accessories.push('S'),
            ..0 => accessories.push('C'),
            0 => {}
        }
        let (mist, flood) = self.coolant;
        if flood {
            accessories.push('F');
        }
        if mist {
            accessories.push('M');
        }
        if !accessories.is_empty() {
            let _ = write!(text, "|A:{accessories}");
        }
        text.push('>');
        text
    }
}

/// Answer to `$G`: the words in force in the order of Grbl.
pub(super) fn modes(dialog: &Dialog, coolant: (bool, bool)) -> String {
    let modes = dialog.modes();
    let words: Vec<&str> = modes.split(' ').collect();
    let among = |names: &[&str], default: &'static str| -> String {
        let word = words.iter().find(|word| names.contains(word));
        (*word.unwrap_or(&default)).to_string()
    };
    let value = |letter: char| {
        let word = words.iter().find_map(|word| word.strip_prefix(letter));
        word.unwrap_or("0").to_string()
    };
    let coolant = match coolant {
        (false, false) => "M9",
        (true, false) => "M7",
        (false, true) => "M8",
        (true, true) => "M7 M8",
    };
    format!(
        "[GC:{} {} {} {} {} {} {} {coolant} T{} F{} S{}]",
        words[0],
        among(&SYSTEM_NAMES, "G54"),
        among(&["G17", "G18", "G19"], "G17"),
        among(&["G20", "G21"], "G21"),
        among(&["G90", "G91"], "G90"),
        among(&["G93", "G94", "G95"], "G94"),
        among(&["M3", "M4", "M5"], "M5"),
        value('T'),
        value('F'),
        value('S'),
    )
}

/// Answers to `$#`.
pub(super) fn offsets(dialog: &Dialog) -> Vec<String> {
    let offsets = dialog.offsets();
    let of = |values: &PerLetter| triple([values[0], values[1], values[2]]);
    let systems = SYSTEM_NAMES.iter().zip(&offsets.systems).take(6);
    let mut lines: Vec<String> = systems
        .map(|(name, system)| format!("[{name}:{}]", of(&system.origin)))
        .collect();
    lines.push(format!("[G28:{}]", of(&offsets.g28)));
    lines.push(format!("[G30:{}]", of(&offsets.g30)));
    let shift = if offsets.g92_active {
        offsets.g92
    } else {
        PerLetter::default()
    };
    lines.push(format!("[G92:{}]", of(&shift)));
    lines.push("[TLO:0.000]".to_string());
    lines.push("[PRB:0.000,0.000,0.000:0]".to_string());
    lines
}

/// Answers to `$$`: settings of a sender, from the machine file.
pub(super) fn settings(machine: &MachineFile) -> Vec<String> {
    let mut lines: Vec<String> = [
        (0, 10),
        (1, 255),
        (2, 0),
        (3, 0),
        (4, 0),
        (5, 0),
        (6, 0),
        (10, 1),
        (13, 0),
        (20, 1),
        (21, 0),
        (22, 1),
        (23, 0),
        (32, 0),
    ]
    .iter()
    .map(|(number, value)| format!("${number}={value}"))
    .collect();
    let axes = axes(machine).map(|index| index.and_then(|index| machine.pose.get(index)));
    type Value = fn(&haptimill_machine_file::AxisLimits) -> f64;
    // Steps per mm are those of an axis unit: the joints need not be along the axes.
    let values: [(u16, Value); 4] = [
        (100, |axis| {
            haptimill_machine_file::scale::per_unit(axis.kind)
        }),
        (110, |axis| axis.rate * 60.0),
        (120, |axis| axis.acceleration),
        (130, |axis| axis.high - axis.low),
    ];
    for (first, value) in values {
        for (number, axis) in (first..).zip(&axes) {
            let linear = axis.filter(|axis| axis.kind == AxisKind::Linear);
            lines.push(format!("${number}={:.3}", linear.map_or(0.0, value)));
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The format of the Grbl 1.1 interface description.
    #[test]
    fn a_status_has_the_documented_fields() {
        let status = Status {
            state: "Run",
            machine: [1.0, -0.0001, 2.5],
            offset: [0.0, 0.0, -3.25],
            feed_mm_min: 499.6,
            spindle_rpm: -1200,
            coolant: (false, true),
            overrides: [110, 50, 100],
            room: true,
        };
        assert_eq!(
            status.text(),
            "<Run|MPos:1.000,0.000,2.500|Bf:15,128|FS:500,1200|WCO:0.000,0.000,-3.250|\
             Ov:110,50,100|A:CF>"
        );
    }

    #[test]
    fn settings_are_those_of_the_machine_file() {
        let machine = MachineFile::built_in().unwrap();
        let lines = settings(&machine);
        let index = axes(&machine)[2].unwrap();
        let travel = machine.pose[index].high - machine.pose[index].low;
        assert!(lines.contains(&format!("$132={travel:.3}")), "{lines:?}");
        assert!(lines.contains(&"$22=1".to_string()));
    }
}
