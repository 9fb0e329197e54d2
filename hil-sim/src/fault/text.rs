//! Faults as one line of text: `name key=value ... at=1.5s for=200ms`. Blanks or commas separate
//! the keys, which may be in any order.

use super::catalogue::CATALOGUE;
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
    fn joint(&mut self) -> Result<String, String> {
        match self.need("joint")? {
            "" => Err("`joint=` is empty".into()),
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
        .ok_or("empty; must be a name and its keys, like `joint-jammed joint=y at=1.5s`")?;
    let entry = CATALOGUE.iter().find(|entry| entry.name == name);
    let entry = entry.ok_or_else(|| {
        let names: Vec<_> = CATALOGUE.iter().map(|entry| entry.name).collect();
        format!(
            "unknown fault `{name}`; the faults are {}",
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
            return Err(format!("`{key}=` is a duplicate; remove one"));
        }
        pairs.push((key, value));
    }
    let mut keys = Keys(pairs);
    let at_s = keys.seconds("at")?.unwrap_or(0.0);
    let for_s = keys.seconds("for")?;
    let what = kind(name, &mut keys).map_err(takes)?;
    match keys.0.first() {
        Some((key, _)) => Err(takes(format!("`{key}=` is not a key of this fault"))),
        None => Ok(Fault { at_s, for_s, what }),
    }
}

fn kind(name: &str, keys: &mut Keys<'_>) -> Result<FaultKind, String> {
    Ok(match name {
        "encoder-stuck" => FaultKind::EncoderStuck {
            joint: keys.joint()?,
            channel: keys.word("channel")?,
            level: keys.word("level")?,
        },
        "encoder-swapped" => FaultKind::EncoderSwapped {
            joint: keys.joint()?,
        },
        "encoder-slip" => FaultKind::EncoderSlip {
            joint: keys.joint()?,
            counts: keys.number("counts")?,
        },
        "encoder-noise" => FaultKind::EncoderNoise {
            joint: keys.joint()?,
            per_second: keys.number("per-second")?,
        },
        "index-missing" => FaultKind::IndexMissing {
            joint: keys.joint()?,
        },
        "drive-dead" => FaultKind::DriveDead {
            joint: keys.joint()?,
        },
        "drive-tripped" => FaultKind::DriveTripped {
            joint: keys.joint()?,
        },
        "drive-weak" => FaultKind::DriveWeak {
            joint: keys.joint()?,
            gain: keys.number("gain")?,
        },
        "drive-reversed" => FaultKind::DriveReversed {
            joint: keys.joint()?,
        },
        "joint-jammed" => {
            let joint = keys.joint()?;
            let given = keys.0.iter().any(|(key, _)| *key == "effort");
            FaultKind::JointJammed {
                joint,
                effort: if given {
                    Some(keys.number("effort")?)
                } else {
                    None
                },
            }
        }
        "push" => FaultKind::Push {
            joint: keys.joint()?,
            effort: keys.number("effort")?,
        },
        "switch-stuck" => FaultKind::SwitchStuck {
            joint: keys.joint()?,
            switch: keys.word("switch")?,
            active: keys.word("active")?,
        },
        "switch-inverted" => FaultKind::SwitchInverted {
            joint: keys.joint()?,
            switch: keys.word("switch")?,
        },
        "switch-missing" => FaultKind::SwitchMissing {
            joint: keys.joint()?,
            switch: keys.word("switch")?,
        },
        "switch-bounces" => FaultKind::SwitchBounces {
            joint: keys.joint()?,
            switch: keys.word("switch")?,
            ms: keys.number("ms")?,
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
        "input-level" => FaultKind::InputLevel {
            name: keys.need("name")?.to_owned(),
            level: keys.word("level")?,
        },
        "input-bounce" => FaultKind::InputBounce {
            name: keys.need("name")?.to_owned(),
            hz: keys.number("hz")?,
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
        _ => match name.strip_prefix("haptic-") {
            Some(rest) => FaultKind::HapticArm(HapticFault::read(rest, keys)?),
            None => return Err(format!("{name} is in the catalogue only")),
        },
    })
}

impl fmt::Display for Fault {
    /// Formats the line that parses back to the same fault.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.what {
            FaultKind::EncoderStuck {
                joint,
                channel,
                level,
            } => {
                write!(
                    f,
                    "encoder-stuck joint={joint} channel={} level={}",
                    channel.word(),
                    level.word()
                )
            }
            FaultKind::EncoderSwapped { joint } => write!(f, "encoder-swapped joint={joint}"),
            FaultKind::EncoderSlip { joint, counts } => {
                write!(f, "encoder-slip joint={joint} counts={counts}")
            }
            FaultKind::EncoderNoise { joint, per_second } => {
                write!(f, "encoder-noise joint={joint} per-second={per_second}")
            }
            FaultKind::IndexMissing { joint } => write!(f, "index-missing joint={joint}"),
            FaultKind::DriveDead { joint } => write!(f, "drive-dead joint={joint}"),
            FaultKind::DriveTripped { joint } => write!(f, "drive-tripped joint={joint}"),
            FaultKind::DriveWeak { joint, gain } => {
                write!(f, "drive-weak joint={joint} gain={gain}")
            }
            FaultKind::DriveReversed { joint } => write!(f, "drive-reversed joint={joint}"),
            FaultKind::JointJammed {
                joint,
                effort: None,
            } => write!(f, "joint-jammed joint={joint}"),
            FaultKind::JointJammed {
                joint,
                effort: Some(effort),
            } => {
                write!(f, "joint-jammed joint={joint} effort={effort}")
            }
            FaultKind::Push { joint, effort } => write!(f, "push joint={joint} effort={effort}"),
            FaultKind::SwitchInverted { joint, switch } => {
                write!(f, "switch-inverted joint={joint} switch={}", switch.word())
            }
            FaultKind::SwitchMissing { joint, switch } => {
                write!(f, "switch-missing joint={joint} switch={}", switch.word())
            }
            FaultKind::SwitchBounces { joint, switch, ms } => {
                write!(
                    f,
                    "switch-bounces joint={joint} switch={} ms={ms}",
                    switch.word()
                )
            }
            FaultKind::SwitchStuck {
                joint,
                switch,
                active,
            } => {
                write!(
                    f,
                    "switch-stuck joint={joint} switch={} active={}",
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
            FaultKind::InputLevel { name, level } => {
                write!(f, "input-level name={name} level={}", level.word())
            }
            FaultKind::InputBounce { name, hz } => {
                write!(f, "input-bounce name={name} hz={hz}")
            }
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
    use super::super::catalogue::catalogue;
    use super::*;

    /// Every entry of the catalogue, with example values, parses and formats back; each of its keys
    /// is known or required.
    #[test]
    fn every_catalogue_entry_can_be_read() {
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
