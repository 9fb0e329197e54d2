//! Named inputs and outputs in a status.

use haptimill_machine_file::{AnalogName, IoNames};
use haptimill_protocol::message::IoTelemetry;
use serde_json::{Value, json};
use std::fmt::Write as _;

/// Named inputs and outputs with their values; without their names where the machine file is not
/// known.
pub(super) struct IoStatus {
    inputs: Vec<(String, bool)>,
    outputs: Vec<(String, bool)>,
    analog_inputs: Vec<(String, f64, String)>,
    analog_outputs: Vec<(String, f64, String)>,
}

impl IoStatus {
    /// Joins the names of a machine file with telemetry.
    pub(super) fn new(names: &IoNames, telemetry: Option<&IoTelemetry>) -> Self {
        let levels = |names: &[String], bits: u16| -> Vec<(String, bool)> {
            let all = names.iter().enumerate();
            all.map(|(index, name)| (name.clone(), bits >> index & 1 != 0))
                .collect()
        };
        let values = |names: &[AnalogName], codes: &[i16]| -> Vec<(String, f64, String)> {
            let all = names.iter().zip(codes);
            all.map(|(name, code)| (name.name.clone(), name.value(*code), name.unit.clone()))
                .collect()
        };
        let none = IoTelemetry::default();
        let known = telemetry.is_some();
        let of = telemetry.unwrap_or(&none);
        let names = if known {
            names.clone()
        } else {
            IoNames::default()
        };
        Self {
            inputs: levels(&names.inputs, of.inputs),
            outputs: levels(&names.outputs, of.outputs),
            analog_inputs: values(&names.analog_inputs, &of.analog_inputs),
            analog_outputs: values(&names.analog_outputs, &of.analog_outputs),
        }
    }

    /// Levels and values of the inputs.
    pub(super) fn inputs_json(&self) -> Value {
        object(&self.inputs, &self.analog_inputs)
    }

    /// Values of the outputs.
    pub(super) fn outputs_json(&self) -> Value {
        object(&self.outputs, &self.analog_outputs)
    }

    /// Writes a line of inputs and a line of outputs, where there are any.
    pub(super) fn write(&self, text: &mut String) {
        let inputs = line(&self.inputs, &self.analog_inputs, ["active", "inactive"]);
        if !inputs.is_empty() {
            let _ = writeln!(text, "inputs   {inputs}");
        }
        let outputs = line(&self.outputs, &self.analog_outputs, ["on", "off"]);
        if !outputs.is_empty() {
            let _ = writeln!(text, "outputs  {outputs}");
        }
    }
}

fn object(levels: &[(String, bool)], values: &[(String, f64, String)]) -> Value {
    let levels = levels
        .iter()
        .map(|(name, level)| (name.clone(), json!(level)));
    let values = values
        .iter()
        .map(|(name, value, _)| (name.clone(), json!(value)));
    Value::Object(levels.chain(values).collect())
}

fn line(levels: &[(String, bool)], values: &[(String, f64, String)], words: [&str; 2]) -> String {
    let levels = levels.iter().map(|(name, level)| {
        let word = words[usize::from(!*level)];
        format!("  {name} {word}")
    });
    let values = values.iter().map(|(name, value, unit)| {
        let text = format!("  {name} {value:.4} {unit}");
        text.trim_end().to_string()
    });
    levels.chain(values).collect()
}
