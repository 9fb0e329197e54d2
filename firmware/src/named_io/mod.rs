//! Named inputs and outputs: filtered levels of the inputs, the latch of a probe, and the values of
//! the outputs.
//!
//! An input has a level per control period: active or not. A filter delays a change of the level
//! by its duration. The latch of a probe does not wait for the filter: it holds the position of the
//! first period of the new level, and counts once the filter has passed.
//!
//! An output has the value that a command or an action of a setpoint gave it. A fault or an
//! emergency stop sets every output to its safe value; the silence of the host sets those that are
//! configured so.

pub mod config;

use crate::io::{ANALOG, Inputs};
use config::{DIGITAL, IoConfig, OutputFunction};
use haptimill_kinematics::{Joints, Pose};
use haptimill_protocol::message::{OutputProblem, Refusal};

/// Position of the machine in the period in which a probe changed its level.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ProbeLatch {
    /// The control period.
    pub period: u64,
    /// Measured joint positions of that period.
    pub joints: Joints,
    /// Pose that was commanded for that period.
    pub commanded: Pose,
}

/// Armed probing: the next motion ends when an input takes a level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Probing {
    /// Index of the input.
    pub input: u8,
    /// The level that ends the motion.
    pub active: bool,
}

/// Named inputs and outputs, in the order of the configuration; zeros for those that the machine
/// lacks.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct IoSnapshot {
    /// Filtered levels of the digital inputs, one bit per input; 1 is active.
    pub inputs: u16,
    /// Values of the digital outputs, one bit per output; 1 is on.
    pub outputs: u16,
    /// Codes of the analog inputs.
    pub analog_inputs: [i16; ANALOG],
    /// Codes of the analog outputs.
    pub analog_outputs: [i16; ANALOG],
}

/// Levels of the named inputs and values of the named outputs.
#[derive(Debug, Default)]
pub struct NamedIo {
    /// Inputs were measured at least once.
    begun: bool,
    /// The digital word of the last period.
    word: u32,
    /// Filtered levels, one bit per input; 1 is active.
    levels: u16,
    /// Inputs whose level in the last period differed from the filtered one.
    pending: u16,
    /// Periods for which the level of an input has differed.
    held: [u16; DIGITAL],
    /// Inputs whose filtered level changed in this period.
    changed: u16,
    /// Codes of the analog inputs.
    analog_inputs: [i16; ANALOG],
    probing: Option<Probing>,
    latch: ProbeLatch,
    /// Values of the outputs, one bit per output; 1 is on.
    outputs: u16,
    /// Codes of the analog outputs.
    analog_outputs: [i16; ANALOG],
}

/// Bit of an index.
pub(crate) const fn bit(index: usize) -> u16 {
    1 << (index & (DIGITAL - 1))
}

impl NamedIo {
    /// The outputs at their safe values, and no input seen yet.
    #[must_use]
    pub fn new(config: &IoConfig) -> Self {
        let mut io = Self::default();
        io.make_safe(config, true);
        io
    }

    /// Reads the levels of this period. `position` gives the position of the machine, for a probe
    /// that begins to change its level.
    #[inline]
    pub fn measure(
        &mut self,
        config: &IoConfig,
        inputs: &Inputs,
        position: impl FnOnce() -> ProbeLatch,
    ) {
        self.changed = 0;
        self.analog_inputs = inputs.analog;
        if config.inputs.is_empty()
            || (self.begun && inputs.digital == self.word && self.pending == 0)
        {
            return;
        }
        self.word = inputs.digital;
        let before = self.pending;
        self.filter(config);
        // The armed input begins to change: a filter of 0 periods changes it at once.
        let begun = (self.pending | self.changed) & !before;
        if let Some(probing) = self.probing
            && begun & bit(usize::from(probing.input)) != 0
        {
            self.latch = position();
        }
    }

    #[inline(never)]
    fn filter(&mut self, config: &IoConfig) {
        let begun = core::mem::replace(&mut self.begun, true);
        let held = self.held.iter_mut();
        for (index, (input, held)) in config.inputs.iter().zip(held).enumerate() {
            let bit = bit(index);
            let active = (self.word >> (input.channel & 31) & 1 != 0) != input.inverted;
            if active == (self.levels & bit != 0) {
                self.pending &= !bit;
                *held = 0;
            } else if *held >= input.filter || !begun {
                // The levels of the first period are taken as they are.
                self.levels ^= bit;
                self.pending &= !bit;
                *held = 0;
                self.changed |= if begun { bit } else { 0 };
            } else {
                self.pending |= bit;
                *held += 1;
            }
        }
    }

    /// Filtered levels of the inputs, one bit per input; 1 is active.
    #[must_use]
    pub const fn levels(&self) -> u16 {
        self.levels
    }

    /// Whether an input is active.
    #[must_use]
    pub const fn is_active(&self, input: usize) -> bool {
        self.levels & bit(input) != 0
    }

    /// Inputs whose filtered level changed in this period, one bit per input.
    #[must_use]
    pub const fn changed(&self) -> u16 {
        self.changed
    }

    /// The first active input whose configuration fulfils a condition.
    #[must_use]
    pub fn active_with(
        &self,
        config: &IoConfig,
        condition: impl Fn(config::InputFunction) -> bool,
    ) -> Option<u8> {
        let mut inputs = config.inputs.iter().enumerate();
        inputs
            .find(|(index, input)| self.is_active(*index) && condition(input.function))
            .map(|(index, _)| index as u8)
    }

    /// State for recorders.
    #[inline]
    pub fn snapshot(&self, config: &IoConfig) -> IoSnapshot {
        let mut snapshot = IoSnapshot::default();
        if config.is_empty() {
            return snapshot;
        }
        snapshot.inputs = self.levels;
        snapshot.outputs = self.outputs;
        snapshot.analog_inputs = core::array::from_fn(|input| self.analog_input(config, input));
        snapshot.analog_outputs = self.analog_outputs;
        snapshot
    }

    /// Code of an analog input.
    #[must_use]
    pub fn analog_input(&self, config: &IoConfig, input: usize) -> i16 {
        let channel = config.analog_inputs.get(input).map(|input| input.channel);
        let code = channel.and_then(|channel| self.analog_inputs.get(usize::from(channel)));
        code.copied().unwrap_or_default()
    }

    /// Arms probing: the next motion ends when the input takes the level `active`. `latch` is the
    /// present position.
    ///
    /// # Errors
    /// [`Refusal::NoProbe`] for an input that is none, or that does not exist.
    pub fn arm(
        &mut self,
        config: &IoConfig,
        probing: Probing,
        latch: ProbeLatch,
    ) -> Result<(), Refusal> {
        let input = config.inputs.get(usize::from(probing.input));
        if !input.is_some_and(|input| input.function.is_probe()) {
            return Err(Refusal::NoProbe {
                input: probing.input,
            });
        }
        self.probing = Some(probing);
        self.latch = latch;
        Ok(())
    }

    /// The armed probing and its latch, for [`NamedIo::rearm`].
    #[must_use]
    pub const fn armed(&self) -> (Option<Probing>, ProbeLatch) {
        (self.probing, self.latch)
    }

    /// Restores what [`NamedIo::armed`] returned.
    pub const fn rearm(&mut self, (probing, latch): (Option<Probing>, ProbeLatch)) {
        self.probing = probing;
        self.latch = latch;
    }

    /// The armed probing.
    #[must_use]
    pub const fn probing(&self) -> Option<Probing> {
        self.probing
    }

    /// Takes the armed probing, which ends it.
    pub const fn take_probing(&mut self) -> Option<Probing> {
        self.probing.take()
    }

    /// Whether the armed input has the level that ends the motion.
    #[must_use]
    pub const fn is_at_contact(&self) -> bool {
        match self.probing {
            Some(Probing { input, active }) => self.is_active(input as usize) == active,
            None => false,
        }
    }

    /// The latch of the armed probe.
    #[must_use]
    pub const fn latch(&self) -> &ProbeLatch {
        &self.latch
    }

    /// Values of the outputs, one bit per output; 1 is on.
    #[must_use]
    pub const fn outputs(&self) -> u16 {
        self.outputs
    }

    /// Code of an analog output.
    #[must_use]
    pub fn analog_output(&self, output: usize) -> i16 {
        self.analog_outputs.get(output).copied().unwrap_or_default()
    }

    /// Checks whether a command may set an output.
    ///
    /// # Errors
    /// [`Refusal::Output`]: no such output, one that follows the spindle, or a tool clamp while the
    /// spindle turns.
    pub fn may_set(&self, config: &IoConfig, output: u8, spindle_rpm: i16) -> Result<(), Refusal> {
        let problem = match config.outputs.get(usize::from(output)) {
            None => OutputProblem::Unknown,
            Some(found) if found.function.follows_spindle() => OutputProblem::FollowsSpindle,
            Some(found) if found.function == OutputFunction::ToolClamp && spindle_rpm != 0 => {
                OutputProblem::SpindleTurns
            }
            Some(_) => return Ok(()),
        };
        Err(Refusal::Output { output, problem })
    }

    /// Checks whether the spindle may turn at a speed.
    ///
    /// # Errors
    /// [`Refusal::Output`]: a tool clamp is off, and the speed is not 0.
    pub fn may_turn(&self, config: &IoConfig, spindle_rpm: i16) -> Result<(), Refusal> {
        let mut outputs = config.outputs.iter();
        let clamp = outputs.position(|output| output.function == OutputFunction::ToolClamp);
        match clamp {
            Some(index) if spindle_rpm != 0 && self.outputs & bit(index) == 0 => {
                Err(Refusal::Output {
                    output: index as u8,
                    problem: OutputProblem::ClampOpen,
                })
            }
            _ => Ok(()),
        }
    }

    /// Sets an output. Callers must check [`NamedIo::may_set`] before.
    pub const fn set(&mut self, output: u8, on: bool) {
        let bit = bit(output as usize);
        self.outputs = self.outputs & !bit | if on { bit } else { 0 };
    }

    /// Checks whether a command may set an analog output to a code.
    ///
    /// # Errors
    /// [`Refusal::AnalogOutput`]: no such output, or a code beyond its range.
    pub fn may_set_analog(config: &IoConfig, output: u8, code: i16) -> Result<(), Refusal> {
        let problem = match config.analog_outputs.get(usize::from(output)) {
            None => OutputProblem::Unknown,
            Some(found) if !(found.low..=found.high).contains(&code) => OutputProblem::Range,
            Some(_) => return Ok(()),
        };
        Err(Refusal::AnalogOutput { output, problem })
    }

    /// Sets an analog output. Callers must check [`NamedIo::may_set_analog`] before.
    pub fn set_analog(&mut self, output: u8, code: i16) {
        if let Some(slot) = self.analog_outputs.get_mut(usize::from(output)) {
            *slot = code;
        }
    }

    /// Sets outputs to their safe values: `all`, or those for which the silence of the host counts.
    /// Returns whether a value changed.
    pub fn make_safe(&mut self, config: &IoConfig, all: bool) -> bool {
        let mut outputs = self.outputs;
        for (index, output) in config.outputs.iter().enumerate() {
            if all || output.safe_without_host {
                outputs = outputs & !bit(index) | if output.safe { bit(index) } else { 0 };
            }
        }
        let mut changed = outputs != self.outputs;
        self.outputs = outputs;
        let codes = self.analog_outputs.iter_mut();
        for (output, code) in config.analog_outputs.iter().zip(codes) {
            if (all || output.safe_without_host) && *code != output.safe {
                *code = output.safe;
                changed = true;
            }
        }
        changed
    }

    /// Switches coolant and mist off, at the end of a job.
    pub fn end_coolant(&mut self, config: &IoConfig) {
        for (index, output) in config.outputs.iter().enumerate() {
            if matches!(
                output.function,
                OutputFunction::Coolant | OutputFunction::Mist
            ) {
                self.outputs &= !bit(index);
            }
        }
    }

    /// Updates the outputs that follow the spindle.
    pub(crate) fn follow_spindle(&mut self, config: &IoConfig, spindle_rpm: i16) {
        for (index, output) in config.outputs.iter().enumerate() {
            let on = match output.function {
                OutputFunction::SpindleOn => spindle_rpm != 0,
                OutputFunction::SpindleReverse => spindle_rpm < 0,
                _ => continue,
            };
            self.outputs = self.outputs & !bit(index) | if on { bit(index) } else { 0 };
        }
    }

    /// The digital word of the board.
    pub(crate) fn digital_word(&self, config: &IoConfig) -> u32 {
        let outputs = config.outputs.iter().enumerate();
        outputs.fold(0, |word, (index, output)| {
            let level = (self.outputs & bit(index) != 0) != output.inverted;
            word | u32::from(level) << (output.channel & 31)
        })
    }

    /// The analog codes of the board.
    pub(crate) fn analog_codes(&self, config: &IoConfig) -> [i16; ANALOG] {
        let mut codes = [0; ANALOG];
        for (output, code) in config.analog_outputs.iter().zip(&self.analog_outputs) {
            if let Some(slot) = codes.get_mut(usize::from(output.channel)) {
                *slot = *code;
            }
        }
        codes
    }
}
