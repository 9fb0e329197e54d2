use super::load::DEFINITIONS;
use super::*;

fn refusal(change: impl Fn(&str) -> String) -> String {
    let (_, text) = DEFINITIONS[7];
    let changed = change(text);
    assert_ne!(changed, text, "nothing was changed");
    Experiment::parse("e8.toml", &changed).unwrap_err()
}

#[test]
fn all_definitions_are_valid_and_in_order() {
    let names: Vec<String> = all().unwrap().into_iter().map(|e| e.name).collect();
    let expected: Vec<String> = (1..=12).map(|number| format!("e{number}")).collect();
    assert_eq!(names, expected);
}

#[test]
fn every_reason_event_and_window_is_used() {
    for experiment in all().unwrap() {
        let measures: Vec<&Measurement> = experiment.expected.iter().map(|e| &e.measure).collect();
        let reason = |key: &String| {
            let mut used = experiment.expected.iter().map(|e| e.reason.as_ref());
            used.any(|used| used == Some(key))
        };
        let window = |key: &String| {
            measures.iter().any(|m| {
                let elsewhere = m.less.iter().chain(&m.over).flat_map(|e| &e.windows);
                m.windows.iter().chain(elsewhere).any(|used| used == key)
            })
        };
        let event = |key: &String| {
            let windows = experiment.windows.values().map(|w| w.to_event.as_ref());
            let mut used = windows.chain(measures.iter().map(|m| m.event.as_ref()));
            used.any(|used| used == Some(key))
        };
        let name = &experiment.name;
        assert!(experiment.reasons.keys().all(reason), "{name}: reasons");
        assert!(experiment.windows.keys().all(window), "{name}: windows");
        assert!(experiment.events.keys().all(event), "{name}: events");
    }
}

#[test]
fn a_mistake_is_refused_with_file_and_key() {
    let replaced = |from: &'static str, to: &'static str| {
        refusal(move |text: &str| text.replacen(from, to, 1))
    };
    let message = replaced("setpoint_n = 5.0", "setpoint_n = \"5\"");
    assert!(message.starts_with("e8.toml:18:14: "), "{message}");
    let message = replaced("setpoint_n", "setpoint");
    assert!(message.contains("unknown field `setpoint`"), "{message}");
    for (from, to, expected) in [
        (
            "examples/block.toml",
            "examples/cube.toml",
            "e8.toml: pass \"cut\": stock: \"examples/cube.toml\" is not built in",
        ),
        (
            "reason = \"return\"",
            "reason = \"retrun\"",
            "e8.toml: expected \"tool error below 0.3 mm, time after the master's stop\": \
             reason: \"retrun\" is not defined",
        ),
        (
            "cause = \"revolution\"",
            "cause = \"turn\"",
            "e8.toml: expected \"peak Fy, largest magnitude\": reason: cause: there is no cause \
             \"turn\"",
        ),
        (
            "name = \"event_time\", event = \"stop\"",
            "name = \"event_time\", event = \"end\"",
            "e8.toml: expected \"master completes its 30 mm at\": measure.event: \"end\" is \
             not defined",
        ),
        (
            "name = \"event_time\", event = \"stop\"",
            "name = \"event_time\"",
            "e8.toml: expected \"master completes its 30 mm at\": measure.event is missing",
        ),
        (
            "name = \"event_time\", event = \"stop\"",
            "name = \"event_times\", event = \"stop\"",
            "e8.toml: expected \"master completes its 30 mm at\": measure.name: there is no \
             measure \"event_times\"",
        ),
        (
            "quantity = \"tool_travel\"",
            "quantity = \"lag\"",
            "e8.toml: expected \"travel of the tool at the end\": measure.quantity: \"lag\" \
             is not recorded in teleoperated passes",
        ),
        (
            "min = 29.0, max = 31.0",
            "min = 31.0, max = 29.0",
            "e8.toml: expected \"travel of the tool at the end\": band: needs min or max, and min <= max",
        ),
    ] {
        assert_eq!(replaced(from, to), expected);
    }
}
