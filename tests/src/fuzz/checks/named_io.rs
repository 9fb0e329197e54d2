//! Named inputs and outputs: safe values, the tool clamp, and the end of a motion at the contact of
//! the armed probe. Levels are read from the wires of the simulated machine and its machine file.

use super::super::bench::FuzzBench;
use super::{CheckResult, Checks};
use haptimill_firmware::io::ANALOG;
use haptimill_firmware::named_io::config::OutputFunction;
use haptimill_protocol::message::State;

/// Control periods after those of its filter within which a contact must end the motion.
const REACTION: u32 = 5;

/// Returns the levels of the named outputs while a fault is latched, from the machine file.
fn safe_outputs(bench: &FuzzBench) -> (u32, [i16; ANALOG]) {
    let mut levels = (0, [0; ANALOG]);
    if bench.controller().machine().is_some() {
        let io = &bench.machine.config.io;
        for output in &io.outputs {
            levels.0 |= u32::from(output.safe != output.inverted) << output.channel;
        }
        for output in &io.analog_outputs {
            levels.1[usize::from(output.channel)] = output.safe;
        }
    }
    levels
}

/// Returns whether the output of the tool clamp is off.
fn has_open_clamp(bench: &FuzzBench) -> bool {
    let configured = bench.controller().machine().is_some();
    let mut outputs = bench.machine.config.io.outputs.iter();
    let clamp = outputs.find(|output| output.function == OutputFunction::ToolClamp);
    clamp.filter(|_| configured).is_some_and(|clamp| {
        (bench.rig.outputs().digital >> clamp.channel & 1 == 1) == clamp.inverted
    })
}

impl Checks {
    /// Checks named inputs and outputs of this period.
    pub(super) fn check_named_io(&mut self, bench: &FuzzBench) -> CheckResult {
        if self.foreign_configuration {
            self.contact_periods = 0;
            self.opened_clamp = true;
            return Ok(());
        }
        let state = bench.controller().safety().state();
        let outputs = bench.rig.outputs();
        let latched = matches!(state, State::Fault | State::EmergencyStop);
        if latched && (outputs.digital, outputs.analog) != safe_outputs(bench) {
            violated!(
                bench,
                "outputs not safe",
                "state {state:?}, digital {:#b}, analog {:?}",
                outputs.digital,
                outputs.analog
            );
        }
        let is_open = has_open_clamp(bench);
        // A refused start of the spindle ends the job: it stays off until then.
        let rests = !matches!(state, State::Run | State::Hold);
        self.opened_clamp = is_open || self.opened_clamp && !rests;
        if outputs.spindle_rpm != 0 && is_open {
            violated!(
                bench,
                "open tool clamp",
                "the spindle turns at {} rev/min in {state:?}",
                outputs.spindle_rpm
            );
        }
        self.check_probe(bench, state)
    }

    /// Checks that a motion ends at the contact of the armed probe.
    fn check_probe(&mut self, bench: &FuzzBench, state: State) -> CheckResult {
        let machine = bench.controller().machine();
        let armed = machine.and_then(|machine| machine.io.probing());
        let inputs = &bench.machine.config.io.inputs;
        let Some((armed, input)) =
            armed.and_then(|armed| Some((armed, inputs.get(usize::from(armed.input))?)))
        else {
            self.contact_periods = 0;
            return Ok(());
        };
        let is_active = (bench.rig.inputs().digital >> input.channel & 1 == 1) != input.inverted;
        if is_active == armed.active && matches!(state, State::Run | State::Jog) {
            self.contact_periods += 1;
        } else {
            self.contact_periods = 0;
        }
        if self.contact_periods > u32::from(input.filter) + REACTION {
            violated!(
                bench,
                "armed probe",
                "the motion continues in {state:?}, {} periods after the contact",
                self.contact_periods
            );
        }
        Ok(())
    }
}
