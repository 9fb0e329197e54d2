//! Outputs of a program: from coolant and output words to the actions of setpoints.

use super::limits::Outputs;
use haptimill_gcode::OutputValue;
use haptimill_protocol::message::Action;

/// Returns the actions of a coolant command; none for an output that the machine lacks.
pub(super) fn coolant(outputs: &Outputs, flood: bool, mist: bool) -> [Action; 2] {
    let set = |output: Option<u8>, on| {
        output.map_or(Action::None, |output| Action::Output { output, on })
    };
    [set(outputs.flood, flood), set(outputs.mist, mist)]
}

/// Returns the action of M62 to M65, M67 and M68.
///
/// # Errors
///
/// Returns problem and remedy if the machine has no such output, or the value is out of its range.
pub(super) fn action(
    outputs: &Outputs,
    number: u16,
    value: OutputValue,
) -> Result<Action, (String, String)> {
    let unknown = |word: char, count: usize| {
        let what = format!("{word}{number} is no output of this machine");
        let remedy = match count {
            0 => "it has none: add it to the machine file".to_string(),
            count => format!(
                "write {word}0 to {word}{}, in the order of the file",
                count - 1
            ),
        };
        (what, remedy)
    };
    let index = usize::from(number);
    match value {
        OutputValue::Digital(on) => match outputs.digital.get(index) {
            Some(true) => Ok(Action::Output {
                output: number as u8,
                on,
            }),
            Some(false) => Err((
                format!("output P{number} follows the spindle"),
                "use M3, M4 and M5".into(),
            )),
            None => Err(unknown('P', outputs.digital.len())),
        },
        OutputValue::Analogue(value) => {
            let output = outputs
                .analogue
                .get(index)
                .ok_or_else(|| unknown('E', outputs.analogue.len()))?;
            let code = (value * output.per_unit).round();
            let [low, high] = output.codes.map(f64::from);
            if !(low..=high).contains(&code) {
                // Adding 0 makes 0 of -0.
                let mut ends = [low, high].map(|code| code / output.per_unit + 0.0);
                ends.sort_by(f64::total_cmp);
                let unit = &output.unit;
                return Err((
                    format!("Q{value} is out of the range of output E{number}"),
                    format!("write {:.3} to {:.3} {unit}", ends[0], ends[1])
                        .trim_end()
                        .to_string(),
                ));
            }
            Ok(Action::AnalogOutput {
                output: number as u8,
                code: code as i16,
            })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::limits::AnalogueOutput;
    use super::*;

    fn outputs() -> Outputs {
        Outputs {
            flood: Some(1),
            mist: None,
            digital: vec![true, true, false],
            // The code falls with the value.
            analogue: vec![AnalogueOutput {
                codes: [-32_768, 0],
                per_unit: -3276.8,
                unit: "V".into(),
            }],
        }
    }

    #[test]
    fn words_become_actions() {
        let on = |output, on| Ok(Action::Output { output, on });
        assert_eq!(
            coolant(&outputs(), true, true),
            [on(1, true).unwrap(), Action::None]
        );
        assert_eq!(
            action(&outputs(), 0, OutputValue::Digital(true)),
            on(0, true)
        );
        let half = action(&outputs(), 0, OutputValue::Analogue(5.0));
        assert_eq!(
            half,
            Ok(Action::AnalogOutput {
                output: 0,
                code: -16_384
            })
        );
    }

    #[test]
    fn words_of_no_output_are_refused_with_a_remedy() {
        let refused = |number, value| {
            let (what, remedy) = action(&outputs(), number, value).unwrap_err();
            format!("{what}; {remedy}")
        };
        assert_eq!(
            refused(7, OutputValue::Digital(true)),
            "P7 is no output of this machine; write P0 to P2, in the order of the file"
        );
        assert_eq!(
            refused(2, OutputValue::Digital(false)),
            "output P2 follows the spindle; use M3, M4 and M5"
        );
        assert_eq!(
            refused(0, OutputValue::Analogue(10.5)),
            "Q10.5 is out of the range of output E0; write 0.000 to 10.000 V"
        );
        assert!(refused(1, OutputValue::Analogue(0.0)).contains("write E0 to E0"));
    }
}
