//! Faults as one line of text: `name key=value ... at=1.5s for=200ms`. Blanks or commas separate
//! the keys, which may be in any order.

use super::{Along, Channel, Direction, Fault, FaultError, FaultKind, HapticFault, Level, Switch};
use core::fmt;
use core::str::FromStr;

/// A value of a small enumeration, written as a word.
pub(super) trait Word: Sized + Copy + PartialEq + 'static {
    const WORDS: &'static [(&'static str, Self)];

    fn word(self) -> &'static str {
        Self::WORDS
            .iter()
            .find(|(_, value)| *value == self)
            .map_or("", |(word, _)| word)
    }
}

impl Word for Channel {
    const WORDS: &'static [(&'static str, Self)] = &[("a", Self::A), ("b", Self::B)];
}

impl Word for Level {
    const WORDS: &'static [(&'static str, Self)] = &[("low", Self::Low), ("high", Self::High)];
}

impl Word for Switch {
    const WORDS: &'static [(&'static str, Self)] = &[
        ("home", Self::Home),
        ("limit-low", Self::LimitLow),
        ("limit-high", Self::LimitHigh),
    ];
}

impl Word for Along {
    const WORDS: &'static [(&'static str, Self)] =
        &[("x", Self::X), ("y", Self::Y), ("z", Self::Z)];
}

impl Word for Direction {
    const WORDS: &'static [(&'static str, Self)] = &[
        ("both", Self::Both),
        ("to-machine", Self::ToMachine),
        ("to-host", Self::ToHost),
    ];
}

impl Word for bool {
    const WORDS: &'static [(&'static str, Self)] = &[("yes", true), ("no", false)];
}

/// The unused keys of a line.
pub(super) struct Keys<'a>(Vec<(&'a str, &'a str)>);

impl<'a> Keys<'a> {
    fn take(&mut self, key: &str) -> Option<&'a str> {
        let place = self.0.iter().position(|(name, _)| *name == key)?;
        Some(self.0.remove(place).1)
    }

    fn need(&mut self, key: &str) -> Result<&'a str, String> {
        self.take(key).ok_or_else(|| format!("`{key}=` is missing"))
    }

    /// Reads the name of a joint. [`Fault::place`] checks later whether the machine has it.
    fn axis(&mut self) -> Result<String, String> {
        match self.need("axis")? {
            "" => Err("`axis=` is empty".into()),
            name => Ok(name.to_owned()),
        }
    }

    pub(super) fn number<T: FromStr>(&mut self, key: &str) -> Result<T, String> {
        let text = self.need(key)?;
        text.parse()
            .map_err(|_| format!("`{key}={text}`: not a number that fits"))
    }

    pub(super) fn word<T: Word>(&mut self, key: &str) -> Result<T, String> {
        let text = self.need(key)?;
        T::WORDS
            .iter()
            .find(|(word, _)| *word == text)
            .map(|(_, value)| *value)
            .ok_or_else(|| {
                let words: Vec<_> = T::WORDS.iter().map(|(word, _)| *word).collect();
                format!("`{key}={text}`: must be {}", words.join(" or "))
            })
    }

    fn direction(&mut self) -> Result<Direction, String> {
        if self.0.iter().any(|(name, _)| *name == "direction") {
            self.word("direction")
        } else {
            Ok(Direction::Both)
        }
    }

    fn seconds(&mut self, key: &str) -> Result<Option<f64>, String> {
        let Some(text) = self.take(key) else {
            return Ok(None);
        };
        let units = [("ms", 1e3), ("us", 1e6), ("s", 1.0)];
        let parsed = units.iter().find_map(|(unit, divisor)| {
            Some(text.strip_suffix(unit)?.parse::<f64>().ok()? / divisor)
        });
        parsed
            .map(Some)
            .ok_or_else(|| format!("`{key}={text}`: must be a time like 1.5s, 200ms or 40us"))
    }
}

impl FromStr for Fault {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        parse(text).map_err(|problem| FaultError {
            fault: text.trim().to_owned(),
            problem,
        })
    }
}

fn parse(text: &str) -> Result<Fault, String> {
    let mut words = text.split([' ', ',', '\t']).filter(|word| !word.is_empty());
    let name = words
        .next()
        .ok_or("empty; must be a name and its keys, like `slide-jammed axis=l3 at=1.5s`")?;
    let entry = CATALOGUE.iter().find(|entry| entry.name == name);
    let entry = entry.ok_or_else(|| {
        let names: Vec<_> = CATALOGUE.iter().map(|entry| entry.name).collect();
        format!(
            "no fault is called `{name}`; there are {}",
            names.join(", ")
        )
    })?;
    let takes = |problem: String| format!("{problem}; {}", entry.usage());
    let mut pairs: Vec<(&str, &str)> = Vec::new();
    for word in words {
        let (key, value) = word
            .split_once('=')
            .ok_or_else(|| takes(format!("`{word}`: must be key=value")))?;
        if pairs.iter().any(|(known, _)| *known == key) {
            return Err(format!("`{key}=` is there twice"));
        }
        pairs.push((key, value));
    }
    let mut keys = Keys(pairs);
    let at_s = keys.seconds("at")?.unwrap_or(0.0);
    let for_s = keys.seconds("for")?;
    let what = kind(name, &mut keys).map_err(takes)?;
    match keys.0.first() {
        Some((key, _)) => Err(takes(format!("`{key}=` means nothing here"))),
        None => Ok(Fault { at_s, for_s, what }),
    }
}

fn kind(name: &str, keys: &mut Keys<'_>) -> Result<FaultKind, String> {
    Ok(match name {
        "encoder-stuck" => FaultKind::EncoderStuck {
            axis: keys.axis()?,
            channel: keys.word("channel")?,
            level: keys.word("level")?,
        },
        "encoder-swapped" => FaultKind::EncoderSwapped { axis: keys.axis()? },
        "encoder-slip" => FaultKind::EncoderSlip {
            axis: keys.axis()?,
            counts: keys.number("counts")?,
        },
        "encoder-noise" => FaultKind::EncoderNoise {
            axis: keys.axis()?,
            per_second: keys.number("per-second")?,
        },
        "index-missing" => FaultKind::IndexMissing { axis: keys.axis()? },
        "drive-dead" => FaultKind::DriveDead { axis: keys.axis()? },
        "drive-tripped" => FaultKind::DriveTripped { axis: keys.axis()? },
        "drive-weak" => FaultKind::DriveWeak {
            axis: keys.axis()?,
            gain: keys.number("gain")?,
        },
        "drive-reversed" => FaultKind::DriveReversed { axis: keys.axis()? },
        "slide-jammed" => {
            let axis = keys.axis()?;
            let given = keys.0.iter().any(|(key, _)| *key == "effort");
            FaultKind::SlideJammed {
                axis,
                effort: if given {
                    Some(keys.number("effort")?)
                } else {
                    None
                },
            }
        }
        "push" => FaultKind::Push {
            axis: keys.axis()?,
            effort: keys.number("effort")?,
        },
        "switch-stuck" => FaultKind::SwitchStuck {
            axis: keys.axis()?,
            switch: keys.word("switch")?,
            active: keys.word("active")?,
        },
        "sensor-stuck" => FaultKind::SensorStuck {
            along: keys.word("along")?,
        },
        "sensor-dropped" => FaultKind::SensorDropped {
            along: keys.word("along")?,
        },
        "sensor-reversed" => FaultKind::SensorReversed {
            along: keys.word("along")?,
        },
        "sensor-drift" => FaultKind::SensorDrift {
            along: keys.word("along")?,
            rate: keys.number("rate")?,
        },
        "sensor-saturated" => FaultKind::SensorSaturated {
            along: keys.word("along")?,
            level: keys.word("level")?,
        },
        "spindle-stalled" => FaultKind::SpindleStalled,
        "emergency-stop" => FaultKind::EmergencyStop,
        "missed-periods" => FaultKind::MissedPeriods {
            count: keys.number("count")?,
        },
        "link-errors" => FaultKind::LinkErrors {
            rate: keys.number("rate")?,
            direction: keys.direction()?,
        },
        "link-drop" => FaultKind::LinkDrop {
            rate: keys.number("rate")?,
            direction: keys.direction()?,
        },
        "link-duplicate" => FaultKind::LinkDuplicate {
            rate: keys.number("rate")?,
            direction: keys.direction()?,
        },
        "link-delay" => FaultKind::LinkDelay {
            ms: keys.number("ms")?,
            direction: keys.direction()?,
        },
        "link-cut" => FaultKind::LinkCut {
            direction: keys.direction()?,
        },
        _ => match name.strip_prefix("hand-") {
            Some(rest) => FaultKind::HapticArm(HapticFault::read(rest, keys)?),
            None => return Err(format!("{name} is in the catalogue only")),
        },
    })
}

/// Catalogue entry of a fault.
struct Entry {
    name: &'static str,
    /// Keys of the fault, optional ones in brackets.
    keys: &'static str,
    /// Description of the fault.
    what: &'static str,
}

impl Entry {
    /// Usage line.
    fn usage(&self) -> String {
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
const CATALOGUE: [Entry; 31] = [
    entry(
        "encoder-stuck",
        "axis=NAME channel=a|b level=low|high",
        "a channel of an encoder stands still",
    ),
    entry(
        "encoder-swapped",
        "axis=NAME",
        "the channels of an encoder are swapped: it counts backwards",
    ),
    entry(
        "encoder-slip",
        "axis=NAME counts=N",
        "a counter slips, once",
    ),
    entry(
        "encoder-noise",
        "axis=NAME per-second=N",
        "noise pulses on the channels of an encoder",
    ),
    entry("index-missing", "axis=NAME", "the index line is dead"),
    entry(
        "drive-dead",
        "axis=NAME",
        "the drive gives nothing and says that it is well",
    ),
    entry(
        "drive-tripped",
        "axis=NAME",
        "the drive gives nothing and says so",
    ),
    entry(
        "drive-weak",
        "axis=NAME gain=X",
        "the drive gives X times what it is asked for",
    ),
    entry(
        "drive-reversed",
        "axis=NAME",
        "the drive pulls the wrong way",
    ),
    entry(
        "slide-jammed",
        "axis=NAME [effort=X]",
        "X N (or N m) of friction more; without X it is held fast",
    ),
    entry(
        "push",
        "axis=NAME effort=X",
        "something pushes with X N (or N m)",
    ),
    entry(
        "switch-stuck",
        "axis=NAME switch=home|limit-low|limit-high active=yes|no",
        "a switch stands still",
    ),
    entry(
        "sensor-stuck",
        "along=x|y|z",
        "the force sensor's codes stand still",
    ),
    entry(
        "sensor-dropped",
        "along=x|y|z",
        "the force sensor's signal is lost: codes of 0",
    ),
    entry(
        "sensor-reversed",
        "along=x|y|z",
        "the force sensor is wired the wrong way round",
    ),
    entry(
        "sensor-drift",
        "along=x|y|z rate=X",
        "the force sensor drifts by X N/s",
    ),
    entry(
        "sensor-saturated",
        "along=x|y|z level=low|high",
        "the force sensor stands at an end of its range",
    ),
    entry(
        "hand-encoder-stuck",
        "leg=N sensor=slide|turn|hinge channel=a|b level=low|high",
        "a channel of an encoder of the haptic arm stands still",
    ),
    entry(
        "hand-encoder-swapped",
        "leg=N sensor=slide|turn|hinge",
        "the channels of an encoder of the haptic arm are swapped",
    ),
    entry(
        "hand-encoder-slip",
        "leg=N sensor=slide|turn|hinge counts=N",
        "a counter of the haptic arm jumps, once",
    ),
    entry(
        "hand-encoder-dropped",
        "leg=N sensor=slide|turn|hinge",
        "the plug of an encoder of the haptic arm is out",
    ),
    entry(
        "hand-encoder-noise",
        "leg=N sensor=slide|turn|hinge per-second=N",
        "noise pulses on the channels of an encoder of the haptic arm",
    ),
    entry(
        "hand-amplifiers-tripped",
        "",
        "the amplifiers of the haptic arm give nothing and say so",
    ),
    entry("spindle-stalled", "", "the spindle stands"),
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
        "bytes come twice, each with probability X",
    ),
    entry(
        "link-delay",
        "ms=X [direction=...]",
        "bytes come X milliseconds later",
    ),
    entry("link-cut", "[direction=...]", "nothing gets through"),
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

impl fmt::Display for Fault {
    /// Formats the line that parses back to the same fault.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.what {
            FaultKind::EncoderStuck {
                axis,
                channel,
                level,
            } => {
                write!(
                    f,
                    "encoder-stuck axis={axis} channel={} level={}",
                    channel.word(),
                    level.word()
                )
            }
            FaultKind::EncoderSwapped { axis } => write!(f, "encoder-swapped axis={axis}"),
            FaultKind::EncoderSlip { axis, counts } => {
                write!(f, "encoder-slip axis={axis} counts={counts}")
            }
            FaultKind::EncoderNoise { axis, per_second } => {
                write!(f, "encoder-noise axis={axis} per-second={per_second}")
            }
            FaultKind::IndexMissing { axis } => write!(f, "index-missing axis={axis}"),
            FaultKind::DriveDead { axis } => write!(f, "drive-dead axis={axis}"),
            FaultKind::DriveTripped { axis } => write!(f, "drive-tripped axis={axis}"),
            FaultKind::DriveWeak { axis, gain } => write!(f, "drive-weak axis={axis} gain={gain}"),
            FaultKind::DriveReversed { axis } => write!(f, "drive-reversed axis={axis}"),
            FaultKind::SlideJammed { axis, effort: None } => write!(f, "slide-jammed axis={axis}"),
            FaultKind::SlideJammed {
                axis,
                effort: Some(effort),
            } => {
                write!(f, "slide-jammed axis={axis} effort={effort}")
            }
            FaultKind::Push { axis, effort } => write!(f, "push axis={axis} effort={effort}"),
            FaultKind::SwitchStuck {
                axis,
                switch,
                active,
            } => {
                write!(
                    f,
                    "switch-stuck axis={axis} switch={} active={}",
                    switch.word(),
                    active.word()
                )
            }
            FaultKind::SensorStuck { along } => write!(f, "sensor-stuck along={}", along.word()),
            FaultKind::SensorDropped { along } => {
                write!(f, "sensor-dropped along={}", along.word())
            }
            FaultKind::SensorReversed { along } => {
                write!(f, "sensor-reversed along={}", along.word())
            }
            FaultKind::SensorDrift { along, rate } => {
                write!(f, "sensor-drift along={} rate={rate}", along.word())
            }
            FaultKind::SensorSaturated { along, level } => {
                write!(
                    f,
                    "sensor-saturated along={} level={}",
                    along.word(),
                    level.word()
                )
            }
            FaultKind::HapticArm(fault) => write!(f, "{fault}"),
            FaultKind::SpindleStalled => f.write_str("spindle-stalled"),
            FaultKind::EmergencyStop => f.write_str("emergency-stop"),
            FaultKind::MissedPeriods { count } => write!(f, "missed-periods count={count}"),
            FaultKind::LinkErrors { rate, direction } => {
                write!(f, "link-errors rate={rate} direction={}", direction.word())
            }
            FaultKind::LinkDrop { rate, direction } => {
                write!(f, "link-drop rate={rate} direction={}", direction.word())
            }
            FaultKind::LinkDuplicate { rate, direction } => {
                write!(
                    f,
                    "link-duplicate rate={rate} direction={}",
                    direction.word()
                )
            }
            FaultKind::LinkDelay { ms, direction } => {
                write!(f, "link-delay ms={ms} direction={}", direction.word())
            }
            FaultKind::LinkCut { direction } => {
                write!(f, "link-cut direction={}", direction.word())
            }
        }?;
        write!(f, " at={}s", self.at_s)?;
        if let Some(time) = self.for_s {
            write!(f, " for={time}s")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every entry of the catalogue, with example values, parses and formats back; each of its keys
    /// is known or required.
    #[test]
    fn the_catalogue_is_what_can_be_read() {
        for entry in &CATALOGUE {
            let mut line = entry.name.to_owned();
            for key in entry.keys.split(' ').filter(|key| !key.is_empty()) {
                let optional = key.starts_with('[');
                let (key, values) = key.trim_matches(['[', ']']).split_once('=').expect(key);
                let value = match values {
                    "NAME" => "l1",
                    "N" => "3",
                    "X" => "0.5",
                    "..." => "to-host",
                    words => words.split('|').next_back().expect(words),
                };
                let without = line.parse::<Fault>();
                assert_eq!(
                    without.is_ok(),
                    optional,
                    "{line} without {key}: {without:?}"
                );
                line = format!("{line} {key}={value}");
            }
            let fault: Fault = line.parse().expect(&line);
            assert_eq!(fault.to_string(), format!("{line} at=0s"));
            assert!(catalogue().contains(entry.what));
        }
    }
}
