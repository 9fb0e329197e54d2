//! Force control: settings of the loops, axes under control, tare of the sensor.

use super::{Line, Session};
use crate::{Error, ErrorKind};
use haptimill_firmware::force::ForceConfig;
use haptimill_machine_file::MachineFile;
use haptimill_machine_file::scale::{PER_EFFORT, PER_MM, to_i32, to_u32};
use haptimill_protocol::force::{EnableCondition, ForceLoop};
use haptimill_protocol::message::{Command, Event, Telemetry};

/// Changes to the force loop of an axis; absent values stay as they are.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ForceLoopChanges {
    /// f_d, N.
    pub setpoint_n: Option<f64>,
    /// K_A, N s^2/mm.
    pub mass: Option<f64>,
    /// K_V, N s/mm.
    pub damping: Option<f64>,
    /// Largest compliant displacement, mm.
    pub limit_mm: Option<f64>,
    /// Largest compliant velocity, mm/s.
    pub rate_mm_s: Option<f64>,
    /// Enable condition.
    pub enable_condition: Option<EnableCondition>,
}

impl ForceLoopChanges {
    /// The settings with the changes applied.
    #[must_use]
    pub fn of(&self, default: &ForceLoop) -> ForceLoop {
        let force = |newtons: f64| to_i32(newtons * PER_EFFORT);
        let gain = |gain: f64| to_u32(gain * PER_EFFORT);
        let length = |length: f64| to_i32(length * PER_MM);
        ForceLoop {
            setpoint: self.setpoint_n.map_or(default.setpoint, force),
            mass: self.mass.map_or(default.mass, gain),
            damping: self.damping.map_or(default.damping, gain),
            limit: self.limit_mm.map_or(default.limit, length),
            rate: self.rate_mm_s.map_or(default.rate, length),
            enable_condition: self.enable_condition.unwrap_or(default.enable_condition),
        }
    }
}

/// The force control section of a machine file.
///
/// # Errors
/// The machine has no force sensor.
pub fn find_force_config(machine: &MachineFile) -> Result<&ForceConfig, Error> {
    machine.config.force.as_ref().ok_or_else(|| {
        let model = machine.config.model.descriptor();
        let what = if model.has_force_axes() {
            "the machine has no force sensor; add a section [force], as in machines/h4.toml".into()
        } else {
            format!(
                "force control moves x, y and z of the tool; the coordinates of the model \"{}\" \
                 have other roles",
                model.code
            )
        };
        Error::in_file(&machine.file, what)
    })
}

/// The axes under force control in a status.
pub(super) fn force_axes(status: &Telemetry) -> Vec<u8> {
    let mask = status.force.as_ref().map_or(0, |force| force.mask);
    (0..8).filter(|axis| mask & (1 << axis) != 0).collect()
}

impl<L: Line> Session<L> {
    /// Sets the loops of some axes to those of the machine file, with changes.
    ///
    /// # Errors
    /// The machine has no force sensor, or the controller refuses a value, with its bound.
    pub fn set_force_loops(
        &mut self,
        machine: &MachineFile,
        axes: &[u8],
        choice: &ForceLoopChanges,
    ) -> Result<(), Error> {
        let force = find_force_config(machine)?;
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

    /// Changes the loops of some axes on the controller, and waits until the changes are active.
    ///
    /// # Errors
    /// The controller has no force sensor, or refuses a value, with its bound.
    pub fn change_force_loops(
        &mut self,
        axes: &[u8],
        choice: &ForceLoopChanges,
    ) -> Result<(), Error> {
        for axis in axes {
            let settings = choice.of(&self.force_loop(*axis)?);
            self.ask(Command::ForceLoop {
                axis: *axis,
                settings,
            })?;
            // The controller prepares the settings for some periods.
            let by = self.now_us + 1_000_000;
            while self.force_loop(*axis)? != settings {
                if self.now_us > by {
                    let what = "the controller accepted the settings of the force loop and does not use them; report this";
                    return Err(Error::new(ErrorKind::Internal, what));
                }
            }
        }
        Ok(())
    }

    /// The active settings of the loop of an axis.
    ///
    /// # Errors
    /// The controller has no force sensor.
    pub fn force_loop(&mut self, axis: u8) -> Result<ForceLoop, Error> {
        let first = self.events.len();
        self.ask(Command::ForceSettings { axis })?;
        let by = self.now_us + 5_000_000;
        loop {
            // The event is sent before the acknowledgement, but may arrive after it.
            let reported = self.events[first..]
                .iter()
                .find_map(|(_, event)| match event {
                    Event::ForceSettings { axis: of, settings } if *of == axis => Some(*settings),
                    _ => None,
                });
            if let Some(settings) = reported {
                return Ok(settings);
            }
            if self.now_us > by {
                let what = "force: the controller did not report the settings within 5 s";
                return Err(Error::new(ErrorKind::Port, what));
            }
            self.step()?;
        }
    }

    /// The axes under force control; empty without a force sensor.
    ///
    /// # Errors
    /// The session ended.
    pub fn force_mask(&mut self) -> Result<Vec<u8>, Error> {
        Ok(force_axes(&self.status()?))
    }

    /// Sets the axes under force control.
    ///
    /// # Errors
    /// The controller refuses.
    pub fn set_force_mask(&mut self, axes: &[u8]) -> Result<(), Error> {
        let mask = axes.iter().fold(0, |mask, axis| mask | 1 << axis);
        self.ask(Command::ForceMask { mask })
    }

    /// Tares the force sensor, and waits until that is done.
    ///
    /// # Errors
    /// The controller refuses, at once or after the measurement.
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
                let what = "tare: the controller did not report the end within 5 s";
                return Err(Error::new(ErrorKind::Port, what));
            }
            self.step()?;
        }
    }
}
