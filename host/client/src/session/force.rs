//! Force control on a controller: other settings, axes under control, a new zero of the sensor.

use super::{Line, Session};
use crate::{Error, ErrorKind};
use haptimill_firmware::force::ForceConfig;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::scale::{PER_EFFORT, PER_MM, to_i32, to_u32};
use haptimill_protocol::force::{ForceLoop, Gate};
use haptimill_protocol::message::{Command, Event};

/// What is to be changed in the loop of an axis; what is not said stays as it is.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct LoopChoice {
    /// f_d, N.
    pub desired_n: Option<f64>,
    /// K_A, N s^2/mm.
    pub mass: Option<f64>,
    /// K_V, N s/mm.
    pub damping: Option<f64>,
    /// The most that the tool yields, mm.
    pub limit_mm: Option<f64>,
    /// The fastest that it yields, mm/s.
    pub rate_mm_s: Option<f64>,
    /// When it yields.
    pub gate: Option<Gate>,
}

impl LoopChoice {
    /// The settings of one axis.
    #[must_use]
    pub fn of(&self, default: &ForceLoop) -> ForceLoop {
        let force = |newtons: f64| to_i32(newtons * PER_EFFORT);
        let gain = |gain: f64| to_u32(gain * PER_EFFORT);
        let length = |length: f64| to_i32(length * PER_MM);
        ForceLoop {
            desired: self.desired_n.map_or(default.desired, force),
            mass: self.mass.map_or(default.mass, gain),
            damping: self.damping.map_or(default.damping, gain),
            limit: self.limit_mm.map_or(default.limit, length),
            rate: self.rate_mm_s.map_or(default.rate, length),
            gate: self.gate.unwrap_or(default.gate),
        }
    }
}

/// The force control of a machine file.
///
/// # Errors
/// It has none.
pub fn force_of(machine: &MachineFile) -> Result<&ForceConfig, Error> {
    machine.config.force.as_ref().ok_or_else(|| {
        let what = format!(
            "{}: the machine has no force sensor; add a section [force], as machines/h4.toml has it",
            machine.file
        );
        Error::new(ErrorKind::BadInput, what)
    })
}

impl<L: Line> Session<L> {
    /// Settings for some axes, as the machine file has them but for the choice.
    ///
    /// # Errors
    /// The machine has no force sensor, or the controller refuses a value, with its bound.
    pub fn set_force_loops(
        &mut self,
        machine: &MachineFile,
        axes: &[u8],
        choice: &LoopChoice,
    ) -> Result<(), Error> {
        let force = force_of(machine)?;
        for axis in axes {
            let Some(default) = force.axes.get(usize::from(*axis)) else {
                continue;
            };
            self.ask(Command::ForceLoop {
                axis: *axis,
                settings: choice.of(&ForceLoop::from(default)),
            })?;
        }
        Ok(())
    }

    /// Other settings for some axes, as the controller has them but for the choice; they are in force when this returns.
    ///
    /// # Errors
    /// The controller has no force sensor, or refuses a value, with its bound.
    pub fn change_force_loops(&mut self, axes: &[u8], choice: &LoopChoice) -> Result<(), Error> {
        for axis in axes {
            let settings = choice.of(&self.force_loop(*axis)?);
            self.ask(Command::ForceLoop {
                axis: *axis,
                settings,
            })?;
            // It works them out first, some periods long.
            let by = self.now_us + 1_000_000;
            while self.force_loop(*axis)? != settings {
                if self.now_us > by {
                    let what = "the controller took the settings of the force loop and does not use them; report this";
                    return Err(Error::new(ErrorKind::Internal, what));
                }
            }
        }
        Ok(())
    }

    /// The settings of the loop of an axis that are in force on the controller.
    ///
    /// # Errors
    /// The controller has no force sensor.
    pub fn force_loop(&mut self, axis: u8) -> Result<ForceLoop, Error> {
        let first = self.events.len();
        self.ask(Command::ForceSettings { axis })?;
        let by = self.now_us + 5_000_000;
        loop {
            // Told before the answer, but on a way of its own.
            let told = self.events[first..]
                .iter()
                .find_map(|(_, event)| match event {
                    Event::ForceSettings { axis: of, settings } if *of == axis => Some(*settings),
                    _ => None,
                });
            if let Some(settings) = told {
                return Ok(settings);
            }
            if self.now_us > by {
                let what = "force: the settings were asked for, and not heard of for 5 s";
                return Err(Error::new(ErrorKind::Port, what));
            }
            self.step()?;
        }
    }

    /// Which axes are under force control.
    ///
    /// # Errors
    /// A refusal.
    pub fn set_force_mask(&mut self, axes: &[u8]) -> Result<(), Error> {
        let mask = axes.iter().fold(0, |mask, axis| mask | 1 << axis);
        self.ask(Command::ForceMask { mask })
    }

    /// Takes what the sensor shows as its zero, and waits until that is done.
    ///
    /// # Errors
    /// A refusal, at once or at the end.
    pub fn tare(&mut self) -> Result<(), Error> {
        let first = self.events.len();
        self.ask(Command::Tare)?;
        let by = self.now_us + 5_000_000;
        loop {
            for (_, event) in &self.events[first..] {
                match event {
                    Event::Tared => return Ok(()),
                    Event::TareRefused(refusal) => {
                        let why = self
                            .model
                            .with_axes(|axes| axes.describe(refusal).to_string());
                        let what = format!("tare: the force sensor keeps its zero: {why}");
                        return Err(Error::new(ErrorKind::Command, what));
                    }
                    _ => {}
                }
            }
            if self.now_us > by {
                let what = "tare: nothing was heard of its end for 5 s";
                return Err(Error::new(ErrorKind::Port, what));
            }
            self.step()?;
        }
    }
}
