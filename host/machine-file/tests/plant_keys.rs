//! The rows of `[plant]` in the table of keys have the ranges and defaults of the simulator.

use haptimill_hil_sim::config::PlantConfig;
use haptimill_machine_file::keys::sections;
use haptimill_machine_file::{BUILT_IN, HAPTIC_ARM, MachineFile};
use haptimill_machine_keys::{Default, Key, Values};
use std::path::Path;
use toml::{Table, Value};

const STEP: &str = include_str!("../../../machines/h4-step.toml");
const SWITCHES: &str = include_str!("../../../machines/mill3.toml");

/// Text of a machine file with a model.
fn file_of(model: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../machines");
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    let texts = files
        .iter()
        .map(|file| std::fs::read_to_string(file).unwrap());
    let line = format!("\nmodel = \"{model}\"");
    let mut of_model = texts.filter(|text| text.contains(&line));
    of_model
        .next()
        .unwrap_or_else(|| panic!("no file in machines/ has the model {model}"))
}

/// A machine file whose plant has a section, or can have it.
fn base(path: &str) -> Table {
    let text = match path {
        "plant.joint.drive.steps" => STEP.to_string(),
        "plant.joint.home" => SWITCHES.to_string(),
        _ => match path.strip_prefix("plant.geometry.") {
            Some(model) => file_of(model),
            None => format!("{BUILT_IN}\n{HAPTIC_ARM}"),
        },
    };
    let mut root: Table = text.parse().unwrap();
    if path == "plant.haptic.stops" {
        let stops = "slide_mm = [150.0, 450.0]\nhinge_deg = [8.0, 84.0]\nslide_stiffness = 20.0\n\
                     hinge_stiffness = 2e5\n";
        let haptic = root["plant"]["haptic"].as_table_mut().unwrap();
        haptic.insert("stops".to_string(), Value::Table(stops.parse().unwrap()));
    }
    root
}

/// The machine file with a key of the first section at a path set or removed.
fn with(path: &str, key: &str, value: Option<Value>) -> String {
    let mut root = base(path);
    let mut table = &mut root;
    for part in path.split('.') {
        let entry = table.entry(part).or_insert_with(|| Table::new().into());
        table = match entry {
            Value::Array(list) => list[0].as_table_mut().unwrap(),
            other => other.as_table_mut().unwrap(),
        };
    }
    match value {
        Some(value) => table.insert(key.to_string(), value),
        None => table.remove(key),
    };
    root.to_string()
}

fn number(value: f64, whole: bool) -> Value {
    if whole {
        Value::Integer(value as i64)
    } else {
        Value::Float(value)
    }
}

/// The problems of one key.
fn problems(path: &str, key: &str, value: Value) -> Vec<String> {
    let text = with(path, key, Some(value));
    let problems = MachineFile::parse("machine.toml", &text).err();
    let problems = problems.map(|problems| problems.0).unwrap_or_default();
    let of_key = problems.iter().filter(|problem| {
        problem
            .key
            .split('.')
            .any(|part| part == key || part.starts_with(&format!("{key} ")))
    });
    of_key.map(|problem| problem.what.clone()).collect()
}

/// Rows with one number, by section.
fn rows() -> impl Iterator<Item = (&'static str, &'static Key)> {
    sections()
        .into_iter()
        .filter(|section| section.path.split('.').next() == Some("plant"))
        .flat_map(|section| section.keys.iter().map(move |key| (section.path, key)))
        .filter(|(_, key)| matches!(key.values, Values::Number { count: 1, .. }))
}

#[test]
fn ranges_are_those_of_the_simulator() {
    let mut checked = 0;
    for (path, key) in rows() {
        let Values::Number {
            low, high, whole, ..
        } = key.values
        else {
            continue;
        };
        let step = |value: f64| {
            if whole {
                1.0
            } else {
                0.01 * (1e-6 + value.abs())
            }
        };
        let name = key.name;
        for (end, beyond) in [(low, low - step(low)), (high, high + step(high))] {
            if !end.is_finite() || (whole && beyond < 0.0) {
                continue;
            }
            checked += 1;
            let outside = problems(path, name, number(beyond, whole));
            assert!(!outside.is_empty(), "{path}.{name} = {beyond} is accepted");
            // Bounds by other keys may be narrower.
            if key.bounds.is_empty() {
                let range = format!("allowed is {low} to {high}");
                assert!(
                    outside[0].contains(&range),
                    "{path}.{name}: {outside:?}, not {range}"
                );
                let inside = problems(path, name, number(end, whole));
                assert!(inside.is_empty(), "{path}.{name} = {end}: {inside:?}");
            }
        }
    }
    assert!(checked > 150, "{checked}");
}

#[test]
fn defaults_are_those_of_the_simulator() {
    let mut checked = 0;
    for (path, key) in rows() {
        let Values::Number { whole, .. } = key.values else {
            continue;
        };
        let plant = |value: Option<Value>| -> Option<PlantConfig> {
            let text = with(path, key.name, value);
            let root: Table = text.parse().unwrap();
            root["plant"].clone().try_into().ok()
        };
        let without = plant(None);
        match key.default {
            Default::Number(default) => {
                checked += 1;
                let written = plant(Some(number(default, whole)));
                assert!(written.is_some(), "{path}.{}", key.name);
                assert_eq!(without, written, "{path}.{}", key.name);
            }
            Default::Required => assert!(without.is_none(), "{path}.{} has a default", key.name),
            Default::Text(_) | Default::Absent => assert!(without.is_some(), "{path}.{}", key.name),
        }
    }
    assert!(checked > 40, "{checked}");
}

/// The simulator names its keys where it refuses one that it does not know.
#[test]
fn every_key_of_the_simulator_has_a_row() {
    let sections = sections();
    let plant: Vec<_> = sections
        .iter()
        .filter(|section| section.path.split('.').next() == Some("plant"))
        .collect();
    let mut checked = 0;
    for section in &plant {
        let path = section.path;
        let text = match path {
            // A list that no machine file of the test has.
            "plant.input" => format!("{BUILT_IN}\n[[plant.input]]\nunknown = 1\n"),
            _ => with(path, "unknown", Some(Value::Integer(1))),
        };
        let root: Table = text.parse().unwrap();
        let refused = root["plant"].clone().try_into::<PlantConfig>();
        let refused = refused.expect_err(path).message().to_string();
        assert!(
            refused.contains("unknown field `unknown`"),
            "{path}: {refused}"
        );
        let (_, known) = refused.split_once("expected ").unwrap_or_default();
        let known = known.split('`').skip(1).step_by(2);
        let below = format!("{path}.");
        for name in known {
            checked += 1;
            let is_key = section.keys.iter().any(|key| key.name == name);
            let is_section = plant.iter().any(|section| {
                let rest = section.path.strip_prefix(&below);
                rest.is_some_and(|rest| rest.split('.').next() == Some(name))
            });
            assert!(is_key || is_section, "{path}.{name} is in no table");
        }
    }
    assert!(checked > 150, "{checked}");
}
