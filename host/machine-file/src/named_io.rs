//! Sections `[[input]]`, `[[output]]`, `[[analog_input]]` and `[[analog_output]]`.

use super::document::{Section, real};
use super::scale::to_u16;
use haptimill_firmware::named_io::config::{
    AnalogInputConfig, AnalogOutputConfig, ContactReaction, DIGITAL, InputConfig, InputFunction,
    IoConfig, LONGEST_PERIODS, OutputConfig, OutputFunction,
};
use haptimill_machine_keys::Key;
use haptimill_machine_keys::named_io as keys;
use haptimill_protocol::message::ANALOG;

/// Default filter of an input that is no probe, ms.
const FILTER_MS: f64 = 2.0;

/// Codes of the full scale of an analog channel.
const CODES: f64 = 32_768.0;

/// Names of inputs and outputs, in the order of the configuration.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct IoNames {
    /// Digital inputs.
    pub inputs: Vec<String>,
    /// Digital outputs.
    pub outputs: Vec<String>,
    /// Analog inputs.
    pub analog_inputs: Vec<AnalogName>,
    /// Analog outputs.
    pub analog_outputs: Vec<AnalogName>,
}

/// Name and scale of an analog input or output.
#[derive(Debug, Clone, PartialEq)]
pub struct AnalogName {
    /// Name.
    pub name: String,
    /// Unit of its values; may be empty.
    pub unit: String,
    /// Value of the code 32768; negative where the code falls with the value.
    pub full_scale: f64,
}

impl AnalogName {
    /// Value of a code.
    #[must_use]
    pub fn value(&self, code: i16) -> f64 {
        f64::from(code) * self.full_scale / CODES
    }

    /// The nearest code of a value; it saturates.
    #[must_use]
    pub fn code(&self, value: f64) -> i16 {
        (value * CODES / self.full_scale).round() as i16
    }
}

/// Names of all entries so far.
#[derive(Default)]
struct Seen {
    names: Vec<String>,
}

/// Channels and functions of one list, with the names of their entries.
#[derive(Default)]
struct Used {
    channels: Vec<(u8, String)>,
    functions: Vec<(&'static str, String)>,
}

impl Seen {
    /// Reads a name, which commands and columns of recordings use.
    fn name(&mut self, section: &Section<'_, '_>) -> String {
        let remedy = "add a name of letters, digits, - and _";
        let Some(name) = section.text("name", remedy) else {
            return String::new();
        };
        let fits = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        if name.len() > 24 || !name.chars().all(fits) {
            let what = format!("\"{name}\" is not 1 to 24 letters, digits, - and _");
            section.report("name", what, "rename it");
        } else if self.names.iter().any(|known| known == name) {
            let what = format!("\"{name}\" is the name of another input or output");
            section.report("name", what, "rename one of them");
        } else {
            self.names.push(name.to_string());
        }
        name.to_string()
    }
}

impl Used {
    fn channel(&mut self, section: &Section<'_, '_>, key: Key, name: &str) -> u8 {
        let channel = section.value(key);
        if channel.is_nan() {
            return 0;
        }
        let channel = channel as u8;
        if let Some((_, other)) = self.channels.iter().find(|(used, _)| *used == channel) {
            let what = format!("{channel} is the channel of \"{other}\" already");
            section.report("channel", what, "give each its own channel");
        }
        self.channels.push((channel, name.to_string()));
        channel
    }

    /// Refuses a second entry of a function.
    fn function(&mut self, section: &Section<'_, '_>, function: &'static str, name: &str) {
        if let Some((_, other)) = self.functions.iter().find(|(used, _)| *used == function) {
            let what = format!("\"{function}\" is the function of \"{other}\" already");
            section.report("function", what, "a machine has one; use \"general\"");
        }
        self.functions.push((function, name.to_string()));
    }
}

/// Reads all sections of inputs and outputs.
pub(super) fn read(root: &Section<'_, '_>, period_us: f64) -> (IoConfig, IoNames) {
    let (mut config, mut names, mut seen) =
        (IoConfig::default(), IoNames::default(), Seen::default());
    let mut used = Used::default();
    for section in list(root, "input", DIGITAL) {
        let name = seen.name(&section);
        // Fails beyond the capacity, which was reported.
        let _ = config
            .inputs
            .push(read_input(&section, &mut used, &name, period_us));
        names.inputs.push(name);
        section.finish();
    }
    let mut used = Used::default();
    for section in list(root, "output", DIGITAL) {
        let name = seen.name(&section);
        let _ = config.outputs.push(read_output(&section, &mut used, &name));
        names.outputs.push(name);
        section.finish();
    }
    let mut used = Used::default();
    for section in list(root, "analog_input", ANALOG) {
        let name = seen.name(&section);
        let channel = used.channel(&section, keys::analog_input::channel, &name);
        let _ = config.analog_inputs.push(AnalogInputConfig { channel });
        names.analog_inputs.push(read_scale(&section, name));
        section.finish();
    }
    let mut used = Used::default();
    for section in list(root, "analog_output", ANALOG) {
        let name = seen.name(&section);
        let channel = used.channel(&section, keys::analog_output::channel, &name);
        let analog = read_scale(&section, name);
        let _ = config
            .analog_outputs
            .push(read_analog_output(&section, channel, &analog));
        names.analog_outputs.push(analog);
        section.finish();
    }
    (config, names)
}

/// The sections of an optional list of at most `max` entries.
fn list<'d, 'i>(root: &Section<'d, 'i>, key: &'static str, max: usize) -> Vec<Section<'d, 'i>> {
    if !root.has(key) {
        return Vec::new();
    }
    let sections = root.list(key);
    if sections.len() > max {
        let what = format!("has {} sections, allowed are {max}", sections.len());
        root.report(key, what, "remove some");
    }
    sections
}

fn read_inverted(section: &Section<'_, '_>, key: Key) -> bool {
    let levels = [("high", false), ("low", true)];
    section.has("active") && section.choice(key, &levels) == Some(true)
}

fn read_input(
    section: &Section<'_, '_>,
    used: &mut Used,
    name: &str,
    period_us: f64,
) -> InputConfig {
    let functions = ["general", "probe", "tool_setter", "feed_hold", "door"];
    let function = section
        .choice(keys::input::function, &functions.map(|word| (word, word)))
        .unwrap_or_else(|| {
            // Keys of the unknown function are not reported, too.
            let _ = (section.has("contact"), section.has("run_up_s"));
            "general"
        });
    if function != "general" {
        used.function(section, function, name);
    }
    let channel = used.channel(section, keys::input::channel, name);
    let inverted = read_inverted(section, keys::input::active);
    let is_probe = matches!(function, "probe" | "tool_setter");
    let default = if is_probe { 0.0 } else { FILTER_MS };
    let filter_ms = section.value_or(keys::input::filter_ms, Some(default));
    let periods = |ms: f64| to_u16(ms * 1000.0 / period_us);
    let function = match function {
        "probe" => InputFunction::Probe(read_contact(section)),
        "tool_setter" => InputFunction::ToolSetter(read_contact(section)),
        "feed_hold" => InputFunction::FeedHold,
        "door" => {
            let key = keys::input::run_up_s;
            let run_up_s = section.value(key);
            let longest = f64::from(LONGEST_PERIODS) * period_us / 1e6;
            if run_up_s > longest {
                let what = format!("{run_up_s} is more than 60,000 control periods, {longest} s");
                section.refuse(key, what, "lower it");
            }
            let run_up = periods(run_up_s * 1000.0);
            InputFunction::Door { run_up }
        }
        _ => InputFunction::General,
    };
    InputConfig {
        function,
        channel,
        inverted,
        filter: periods(filter_ms),
    }
}

fn read_contact(section: &Section<'_, '_>) -> ContactReaction {
    let reactions = [
        ("fault", ContactReaction::Fault),
        ("warning", ContactReaction::Warning),
    ];
    let reaction = section
        .has("contact")
        .then(|| section.choice(keys::input::contact, &reactions));
    reaction.flatten().unwrap_or(ContactReaction::Fault)
}

/// Whether the safe value also applies while the host is silent.
fn read_without_host(section: &Section<'_, '_>, key: Key) -> bool {
    let choices = [("safe", true), ("keep", false)];
    !section.has("without_host") || section.choice(key, &choices) != Some(false)
}

fn read_output(section: &Section<'_, '_>, used: &mut Used, name: &str) -> OutputConfig {
    let functions = [
        ("general", OutputFunction::General),
        ("coolant", OutputFunction::Coolant),
        ("mist", OutputFunction::Mist),
        ("tool_clamp", OutputFunction::ToolClamp),
        ("spindle_on", OutputFunction::SpindleOn),
        ("spindle_reverse", OutputFunction::SpindleReverse),
    ];
    let function = section
        .choice(keys::output::function, &functions)
        .unwrap_or(OutputFunction::General);
    if let Some((word, _)) = functions.iter().find(|(_, it)| *it == function)
        && function != OutputFunction::General
    {
        used.function(section, word, name);
    }
    let channel = used.channel(section, keys::output::channel, name);
    let inverted = read_inverted(section, keys::output::active);
    let safe = section.choice(keys::output::safe, &[("off", false), ("on", true)]) == Some(true);
    if safe && function.follows_spindle() {
        let what = "is \"on\", the output follows the spindle, which is off then";
        section.report("safe", what, "write \"off\"");
    }
    if !safe && function == OutputFunction::ToolClamp {
        let what = "is \"off\", and the clamp would release the tool of a spindle that runs down";
        section.report(
            "safe",
            what,
            "write \"on\"; `active` gives the level at which the clamp holds",
        );
    }
    OutputConfig {
        function,
        channel,
        inverted,
        safe,
        safe_without_host: read_without_host(section, keys::output::without_host),
    }
}

/// Reads name, unit and scale of an analog channel.
fn read_scale(section: &Section<'_, '_>, name: String) -> AnalogName {
    let unit = if section.has("unit") {
        let remedy = "write a unit, or leave the key out";
        section.text("unit", remedy).unwrap_or_default()
    } else {
        ""
    };
    let full_scale = section.value(keys::analog_input::full_scale);
    if full_scale.abs() < 1e-9 {
        section.report("full_scale", "is 0", "write the value of the code 32768");
    }
    AnalogName {
        name,
        unit: unit.to_string(),
        full_scale,
    }
}

fn read_analog_output(
    section: &Section<'_, '_>,
    channel: u8,
    analog: &AnalogName,
) -> AnalogOutputConfig {
    let ends = [analog.value(i16::MIN), analog.value(i16::MAX)];
    let (min, max) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
    let range = if analog.full_scale.is_nan() {
        real(-1e9, 1e9, "")
    } else {
        real(min, max, "")
    };
    let low = section.number_or("low", min, range);
    let high = section.number_or("high", max, range);
    let safe = section.number("safe", range);
    if low > high {
        section.report("high", "is below `low`", "exchange them");
    } else if safe < low || safe > high {
        let what = format!("{safe} is outside `low` to `high`, {low} to {high}");
        section.report("safe", what, "write a value between them");
    }
    let codes = [analog.code(low), analog.code(high)];
    let (low, high) = (codes[0].min(codes[1]), codes[0].max(codes[1]));
    AnalogOutputConfig {
        channel,
        low,
        high,
        safe: analog.code(safe).clamp(low, high),
        safe_without_host: read_without_host(section, keys::analog_output::without_host),
    }
}

#[cfg(test)]
mod tests {
    use crate::{BUILT_IN, MachineFile};
    use haptimill_firmware::named_io::config::InputFunction;

    /// The built-in file with sections, which begin at line 3 of the appended text.
    fn parse(sections: &str) -> Result<MachineFile, String> {
        let text = format!("{BUILT_IN}\n\n{sections}");
        MachineFile::parse("mine.toml", &text).map_err(|problems| problems.to_string())
    }

    /// The only problem of the sections: its line in them, its key and what it says.
    fn problem(sections: &str) -> (usize, String) {
        let text = format!("{BUILT_IN}\n\n{sections}");
        let problems = MachineFile::parse("mine.toml", &text).expect_err("a problem");
        assert_eq!(problems.0.len(), 1, "{problems}");
        let first = &problems.0[0];
        let before = BUILT_IN.lines().count() + 1;
        (
            first.line - before,
            format!("{}: {}", first.key, first.what),
        )
    }

    const DOOR: &str = "[[input]]\nname = \"door\"\nfunction = \"door\"\nchannel = 3\n\
                        active = \"low\"\nrun_up_s = 0.02\n";
    const LIGHT: &str = "[[output]]\nname = \"light\"\nfunction = \"general\"\nchannel = 3\n\
                         safe = \"off\"\n";
    const VALVE: &str = "[[analog_output]]\nname = \"valve\"\nchannel = 1\nfull_scale = -10.0\n\
                         low = 0.0\nhigh = 8.0\nsafe = 2.0\n";

    #[test]
    fn keys_are_converted() {
        let machine = parse(&format!("{DOOR}{LIGHT}{VALVE}")).unwrap();
        let config = &machine.config.io;
        let door = &config.inputs[0];
        // 20 ms are 100 periods of 200 us, the default filter of 2 ms is 10.
        assert_eq!(door.function, InputFunction::Door { run_up: 100 });
        assert_eq!((door.channel, door.inverted, door.filter), (3, true, 10));
        assert!(config.outputs[0].safe_without_host && !config.outputs[0].safe);
        let valve = &config.analog_outputs[0];
        // Negative full scale: 8 is the code -26214, 2 is -6554.
        assert_eq!((valve.low, valve.high, valve.safe), (-26_214, 0, -6554));
        assert!((machine.io.analog_outputs[0].value(valve.safe) - 2.0).abs() < 2e-4);
        assert_eq!(machine.io.inputs, ["door"]);
        assert!(parse("").unwrap().config.io.is_empty());
    }

    #[test]
    fn every_mistake_has_its_line_and_key() {
        let edit = |from: &str, to: &str| problem(&DOOR.replacen(from, to, 1));
        let (line, text) = edit("\"door\"\nchannel", "\"gate\"\nchannel");
        assert_eq!(line, 4);
        assert!(
            text.starts_with("input[1].function: \"gate\" is not known"),
            "{text}"
        );
        let (line, text) = edit("channel = 3", "channel = 32");
        assert_eq!(
            (
                line,
                text.starts_with("input[1].channel: 32 is out of range")
            ),
            (5, true)
        );
        let (_, text) = edit("active = \"low\"", "active = \"on\"");
        assert!(
            text.starts_with("input[1].active: \"on\" is not known"),
            "{text}"
        );
        let (_, text) = edit("name = \"door\"", "name = \"my door\"");
        assert!(
            text.starts_with("input[1].name: \"my door\" is not 1 to 24"),
            "{text}"
        );
        let (_, text) = edit("run_up_s = 0.02", "run_up_s = 0.02\ncontact = \"fault\"");
        assert!(
            text.starts_with("input[1].contact: is not a known key"),
            "{text}"
        );
        let second = DOOR
            .replace("name = \"door\"", "name = \"gate\"")
            .replace("= 3", "= 4");
        let (line, text) = problem(&format!("{DOOR}{second}"));
        assert_eq!(line, 10);
        assert!(
            text.starts_with("input[2].function: \"door\" is the function of \"door\""),
            "{text}"
        );
        let (line, text) = problem(&format!("{LIGHT}{}", LIGHT.replace("light", "lamp")));
        assert_eq!(line, 10);
        assert!(
            text.starts_with("output[2].channel: 3 is the channel of \"light\""),
            "{text}"
        );
        // A name is unique among all lists.
        let (_, text) = problem(&format!("{DOOR}{}", LIGHT.replace("light", "door")));
        assert!(
            text.starts_with("output[1].name: \"door\" is the name of another"),
            "{text}"
        );
        let (_, text) = problem(&VALVE.replace("safe = 2.0", "safe = 9.0"));
        assert!(
            text.starts_with("analog_output[1].safe: 9 is outside"),
            "{text}"
        );
        let (_, text) = problem(&LIGHT.replace("general", "spindle_on").replace("off", "on"));
        assert!(
            text.starts_with("output[1].safe: is \"on\", the output follows"),
            "{text}"
        );
        let (_, text) = problem(&LIGHT.replace("general", "tool_clamp"));
        assert!(
            text.starts_with("output[1].safe: is \"off\", and the clamp would release"),
            "{text}"
        );
    }
}
