//! Configuration of the named inputs and outputs. The names are in the machine file; the controller
//! uses the index of an input or output.

use crate::io::ANALOG;
use haptimill_protocol::message::{ConfigField, ConfigProblem};
use heapless::Vec;
use serde::{Deserialize, Serialize};

/// Largest number of named digital inputs, and of named digital outputs.
pub const DIGITAL: usize = 16;

/// Channels of a digital word.
pub const CHANNELS: u8 = 32;

/// Longest filter of an input, and longest wait for the spindle, in control periods.
pub const LONGEST_PERIODS: u16 = 60_000;

/// Named inputs and outputs of a machine; empty on a machine without any.
#[derive(Debug, Clone, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct IoConfig {
    /// Digital inputs.
    pub inputs: Vec<InputConfig, DIGITAL>,
    /// Digital outputs.
    pub outputs: Vec<OutputConfig, DIGITAL>,
    /// Analog inputs.
    pub analog_inputs: Vec<AnalogInputConfig, ANALOG>,
    /// Analog outputs.
    pub analog_outputs: Vec<AnalogOutputConfig, ANALOG>,
}

/// A digital input.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct InputConfig {
    /// Its function.
    pub function: InputFunction,
    /// Bit of [`Inputs::digital`](crate::io::Inputs::digital), 0 to 31.
    pub channel: u8,
    /// The input is active at level 0.
    pub inverted: bool,
    /// Control periods for which a new level must stay before it counts, 0 to
    /// [`LONGEST_PERIODS`]. 0 takes the level of each period.
    pub filter: u16,
}

/// Function of a digital input.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum InputFunction {
    /// None: the level is reported.
    General,
    /// A probe at the tool. See [`ContactReaction`] for a contact without armed probing.
    Probe(ContactReaction),
    /// A tool setter on the table; handled like a probe.
    ToolSetter(ContactReaction),
    /// Holds the job while it is active. `Resume` and `JobStart` are refused meanwhile.
    FeedHold,
    /// Active while the door is open: the job holds, jogs and homing stop, the spindle is off, and
    /// no motion can be started.
    Door {
        /// Control periods from the restart of the spindle to the motion of a resumed job, 0 to
        /// [`LONGEST_PERIODS`].
        run_up: u16,
    },
}

/// Reaction to the contact of a probe or tool setter in motion, when no probing is armed for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ContactReaction {
    /// The machine decelerates and latches
    /// [`Fault::ProbeContact`](haptimill_protocol::message::Fault::ProbeContact).
    Fault,
    /// An event reports it.
    Warning,
}

/// A digital output.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct OutputConfig {
    /// Its function.
    pub function: OutputFunction,
    /// Bit of [`Outputs::digital`](crate::io::Outputs::digital), 0 to 31.
    pub channel: u8,
    /// The output is on at level 0.
    pub inverted: bool,
    /// Safe value: on or off at a fault and at an emergency stop.
    pub safe: bool,
    /// The safe value also applies while the host is silent.
    pub safe_without_host: bool,
}

/// Function of a digital output.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum OutputFunction {
    /// Set by commands and part programs.
    General,
    /// Coolant: like [`OutputFunction::General`], and off at the end of a job.
    Coolant,
    /// Mist coolant: likewise.
    Mist,
    /// Clamp of the tool: on holds the tool. Changes only while the spindle is off, and the spindle
    /// starts only while it is on. Its safe value is on.
    ToolClamp,
    /// On while the spindle is commanded to turn. No command sets it.
    SpindleOn,
    /// On while the spindle is commanded to turn counter-clockwise. No command sets it.
    SpindleReverse,
}

/// An analog input.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct AnalogInputConfig {
    /// Index in [`Inputs::analog`](crate::io::Inputs::analog), 0 to 3.
    pub channel: u8,
}

/// An analog output.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct AnalogOutputConfig {
    /// Index in [`Outputs::analog`](crate::io::Outputs::analog), 0 to 3.
    pub channel: u8,
    /// Smallest code.
    pub low: i16,
    /// Largest code.
    pub high: i16,
    /// Safe code at a fault and at an emergency stop.
    pub safe: i16,
    /// The safe code also applies while the host is silent.
    pub safe_without_host: bool,
}

impl InputFunction {
    /// Whether the input can end a probing motion.
    #[must_use]
    pub const fn is_probe(self) -> bool {
        matches!(self, Self::Probe(_) | Self::ToolSetter(_))
    }
}

impl OutputFunction {
    /// Whether the spindle sets the output, and not a command.
    #[must_use]
    pub const fn follows_spindle(self) -> bool {
        matches!(self, Self::SpindleOn | Self::SpindleReverse)
    }
}

/// Whether a number occurs twice.
fn repeats(channels: impl Iterator<Item = u8>) -> bool {
    let mut seen = 0_u32;
    for channel in channels {
        let bit = 1_u32.checked_shl(u32::from(channel)).unwrap_or(0);
        if bit == 0 || seen & bit != 0 {
            return true;
        }
        seen |= bit;
    }
    false
}

impl IoConfig {
    /// Whether the machine has no named input or output.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.inputs.is_empty()
            && self.outputs.is_empty()
            && self.analog_inputs.is_empty()
            && self.analog_outputs.is_empty()
    }

    /// Checks channels and ranges. Each function but `General` has at most one input or output.
    ///
    /// # Errors
    /// [`ConfigField::Input`] or [`ConfigField::Output`], with the index of the entry, or without
    /// one for a channel that is used twice.
    pub fn check(&self) -> Result<(), ConfigProblem> {
        let problem = |field, index| Err(ConfigProblem { field, index });
        let mut functions = 0_u8;
        for (index, input) in self.inputs.iter().enumerate() {
            let (bit, wait) = match input.function {
                InputFunction::General => (0, 0),
                InputFunction::Probe(_) => (1, 0),
                InputFunction::ToolSetter(_) => (2, 0),
                InputFunction::FeedHold => (4, 0),
                InputFunction::Door { run_up } => (8, run_up),
            };
            let longest = input.filter.max(wait);
            if functions & bit != 0 || input.channel >= CHANNELS || longest > LONGEST_PERIODS {
                return problem(ConfigField::Input, Some(index as u8));
            }
            functions |= bit;
        }
        functions = 0;
        for (index, output) in self.outputs.iter().enumerate() {
            let bit = match output.function {
                OutputFunction::General => 0,
                OutputFunction::Coolant => 1,
                OutputFunction::Mist => 2,
                OutputFunction::ToolClamp => 4,
                OutputFunction::SpindleOn => 8,
                OutputFunction::SpindleReverse => 16,
            };
            // The spindle runs down after a fault: the clamp holds the tool meanwhile.
            let is_unsafe = match output.function {
                OutputFunction::ToolClamp => !output.safe,
                function => function.follows_spindle() && output.safe,
            };
            if functions & bit != 0 || output.channel >= CHANNELS || is_unsafe {
                return problem(ConfigField::Output, Some(index as u8));
            }
            functions |= bit;
        }
        for (index, input) in self.analog_inputs.iter().enumerate() {
            if usize::from(input.channel) >= ANALOG {
                return problem(ConfigField::Input, Some(index as u8));
            }
        }
        for (index, output) in self.analog_outputs.iter().enumerate() {
            let safe = (output.low..=output.high).contains(&output.safe);
            if usize::from(output.channel) >= ANALOG || !safe {
                return problem(ConfigField::Output, Some(index as u8));
            }
        }
        if repeats(self.inputs.iter().map(|input| input.channel))
            || repeats(self.analog_inputs.iter().map(|input| input.channel))
        {
            return problem(ConfigField::Input, None);
        }
        if repeats(self.outputs.iter().map(|output| output.channel))
            || repeats(self.analog_outputs.iter().map(|output| output.channel))
        {
            return problem(ConfigField::Output, None);
        }
        Ok(())
    }
}
