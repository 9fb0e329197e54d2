//! Force control: from the codes of a force sensor to the displacement by which the tool yields.
//!
//! Two stages of the corridor are here. *Sense* ([`ForceControl::sense`]): codes to forces on the tool ([`conditioning`]), their peak over a revolution of the spindle ([`peak`]), and whether sensor and
//! contact can be believed. *Yield* ([`ForceControl::advance`]): the compliant displacement p_c of x, y and z of the work ([`compliance`], [`pole`]) under the eye of [`guard`]; the reference of
//! the kinematics is p_r = p_d + p_c (spec h4-milling (3.31)-(3.33)).
//!
//! | part | units | limits |
//! | --- | --- | --- |
//! | forces | 2^-16 N, reaction on the tool (spec 1.3) | +-2048 N |
//! | p_c | 2^-40 mm | 64 mm, or less by its settings |
//! | K_A, K_V | 2^-16 N s^2/mm, 2^-16 N s/mm | 2^-18 <= K_V T / K_A, and K_A >= K_V T at the highest level of damping |
//! | stiffness of the contact | N/mm | the guard answers for 1000 |
//!
//! Misuse: feeding a desired rate that is not the one that is added. The gate and the guard would act for a motion that does not happen.

pub mod compliance;
pub mod conditioning;
pub mod guard;
pub mod peak;
pub mod pole;

use crate::units::force::{Displacement, Force, VirtualDamping, VirtualMass};
use crate::units::{Angle, Coordinate, Length, Rate};
use compliance::{Compliance, LEVELS, Law, Push, Yielding};
use conditioning::{COMPONENTS, Condition, Conditioner, ForceSample, Sensor};
use guard::{Guard, Sign};
use peak::{Extremes, SlidingExtremes, Window};
use serde::{Deserialize, Serialize};

/// When a force above the desired one moves the tool away (spec h4-milling 7.1 item 20).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Gate {
    /// Only while it opposes the desired motion of the axis: F p_d' < 0. At rest, and across the motion, the tool only returns.
    #[default]
    AgainstMotion,
    /// Always.
    Any,
    /// Only upwards along the axis: contact from above.
    Positive,
    /// Only downwards.
    Negative,
}

/// The loop of one axis.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct LoopSettings {
    /// f_d, a magnitude: the side on which it acts is that of the contact.
    pub desired: Force,
    /// K_A.
    pub mass: VirtualMass,
    /// K_V.
    pub damping: VirtualDamping,
    /// The most that the tool yields.
    pub limit: Length,
    /// The fastest that it yields, and returns.
    pub rate: Rate,
    /// When it yields.
    pub gate: Gate,
}

impl LoopSettings {
    /// The least desired force: 0.5 N, 40 codes of a sensor of +-100 N.
    ///
    /// 0 is no force control but a tool that yields to noise and never returns (its return is f_d / K_V): switch the axis off instead. A negative one has no meaning, since
    /// the sign is that of the contact. Below 40 codes, drift and noise move the tool.
    pub const LEAST_DESIRED: Force = Force::millinewtons(500);
}

/// A parameter that cannot be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Refused {
    /// What is wrong.
    pub parameter: Parameter,
    /// The nearest value that is taken, in the raw unit of the parameter.
    pub bound: i32,
}

/// What can be wrong with settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Parameter {
    /// f_d is zero, negative, or lost in the noise.
    DesiredTooSmall,
    /// f_d is above three quarters of what the sensor shows: the loop could not see by how much a force is too high.
    DesiredTooLarge,
    /// K_V does not hold a soft contact with this delay: K_V >= k tau.
    DampingTooSmall,
    /// K_V is beyond its range.
    DampingTooLarge,
    /// K_A is less than K_V T at the highest level of damping.
    MassTooSmall,
    /// K_A / K_V is beyond 2^18 periods.
    MassTooLarge,
    /// The limit of p_c is not above 0, or too large.
    Limit,
    /// The rate is not above 0.
    Rate,
    /// The sensor's values make no sense.
    Sensor,
    /// A revolution at the slowest spindle does not fit the window.
    SlowestSpindle,
    /// There is no such axis, or it is not linear.
    Axis,
    /// The last change of this axis is still being worked out; a few periods later it will be taken.
    Busy,
}

/// Everything that the machine file says of force control.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ForceConfig {
    /// The sensor.
    pub sensor: Sensor,
    /// The loops of x, y, z.
    pub axes: [LoopSettings; COMPONENTS],
    /// Axes that are under force control after a start: bit 0 for x.
    pub mask: u8,
    /// How late the tool follows its reference, microseconds.
    pub drive_lag_us: u16,
    /// The slowest speed of the spindle at which force control works, rev/min: it gives the longest window of the peak.
    pub slowest_rpm: u16,
}

impl ForceConfig {
    /// What the guard counts on from a motion of the tool to a change of the seen force: one revolution, the drive, and a period and a half. Microseconds.
    #[must_use]
    pub fn delay_us(&self, period_us: u16) -> u32 {
        let revolution = 60_000_000 / u32::from(self.slowest_rpm.max(1));
        revolution
            .saturating_add(u32::from(self.drive_lag_us))
            .saturating_add(u32::from(period_us) * 3 / 2)
    }

    fn window(&self, period_us: u16) -> Option<Window> {
        let rpm = i16::try_from(self.slowest_rpm).ok()?;
        Window::revolution(rpm, period_us)
    }
}

/// A law that is being worked out, one level in a period.
#[derive(Debug, Clone)]
struct Preparing {
    law: Law,
    next: usize,
}

/// One axis.
#[derive(Debug, Clone)]
struct Axis {
    peaks: SlidingExtremes,
    extremes: Extremes,
    compliance: Compliance,
    guard: Guard,
    preparing: Option<Preparing>,
    /// Periods until the next look.
    until_look: u16,
}

/// Force control of a machine.
#[derive(Debug, Clone)]
pub struct ForceControl {
    config: ForceConfig,
    period_us: u16,
    delay_us: u32,
    conditioner: Conditioner,
    axes: [Axis; COMPONENTS],
    mask: u8,
    rpm: i16,
    /// The tool stays where it is: the forces are not believed.
    held: bool,
    condition: Option<Condition>,
    yielding: [Yielding; COMPONENTS],
}

impl ForceControl {
    /// The force control of a configuration. Costs some 10^5 instructions: for the activation of a configuration.
    ///
    /// # Errors
    /// The axis, and what is wrong.
    pub fn new(config: &ForceConfig, period_us: u16) -> Result<Self, (usize, Refused)> {
        let refuse = |parameter, bound| Refused { parameter, bound };
        if !config.sensor.is_sound() {
            return Err((0, refuse(Parameter::Sensor, 0)));
        }
        let Some(window) = config.window(period_us) else {
            // 2048 samples hold a revolution.
            let bound = 60_000_000 / (2048 * i32::from(period_us.max(1))) + 1;
            return Err((0, refuse(Parameter::SlowestSpindle, bound)));
        };
        let delay_us = config.delay_us(period_us);
        let axis = |component: usize| {
            let range = config.sensor.range(component);
            let law = Law::new(&config.axes[component], period_us, delay_us, range)
                .map_err(|refused| (component, refused))?;
            Ok(Axis {
                peaks: SlidingExtremes::new(window),
                extremes: Extremes::default(),
                compliance: Compliance::new(law),
                guard: Guard::default(),
                preparing: None,
                until_look: component as u16 + 1,
            })
        };
        Ok(Self {
            conditioner: Conditioner::new(&config.sensor),
            axes: [axis(0)?, axis(1)?, axis(2)?],
            mask: config.mask,
            config: config.clone(),
            period_us,
            delay_us,
            rpm: 0,
            held: false,
            condition: None,
            yielding: [Yielding::default(); COMPONENTS],
        })
    }

    /// Stage *sense*: the sample of this period, the commanded speed of the spindle, where the tool was measured (or wanted, where there is no certified pose), the angle of the table, and
    /// whether nothing touches the tool.
    pub fn sense(
        &mut self,
        sample: &ForceSample,
        spindle_rpm: i16,
        position: &[Coordinate; COMPONENTS],
        table: Angle,
        unloaded: bool,
    ) {
        if spindle_rpm != self.rpm {
            self.turn(spindle_rpm);
        }
        let mut found = self.conditioner.take(sample, unloaded);
        let forces = *self.conditioner.forces();
        for (component, axis) in self.axes.iter_mut().enumerate() {
            axis.extremes = axis.peaks.push(forces[component]);
            axis.guard.note(position[component]);
            axis.until_look = axis.until_look.saturating_sub(1);
            if axis.until_look == 0 {
                axis.until_look = (axis.peaks.window().samples() / 4).max(1) as u16;
                axis.guard.look(axis.extremes.peak(), axis.compliance.law());
                if component == 0 {
                    self.conditioner.set_table(table);
                }
            }
            if axis.guard.sign() == Sign::Wrong && self.mask & (1 << component) != 0 {
                found = found.or(Some(Condition::WrongSign {
                    component: component as u8,
                }));
            }
        }
        if self.mask != 0 && self.rpm != 0 && self.rpm.unsigned_abs() < self.config.slowest_rpm {
            found = found.or(Some(Condition::SlowSpindle { rpm: self.rpm }));
        }
        self.condition = found;
    }

    /// Another speed of the spindle: another window. A standing spindle leaves the window as it was.
    #[cold]
    fn turn(&mut self, rpm: i16) {
        self.rpm = rpm;
        if rpm.unsigned_abs() < self.config.slowest_rpm {
            return;
        }
        if let Some(window) = Window::revolution(rpm, self.period_us) {
            self.axes
                .iter_mut()
                .for_each(|axis| axis.peaks.set_window(window));
        }
    }

    /// What is wrong with sensor or contact in this period; a reason for a controlled stop while any axis is under force control, and [`ForceControl::hold`] with it.
    #[must_use]
    pub const fn condition(&self) -> Option<Condition> {
        self.condition
    }

    /// Stage *yield*: one period of the loops with the rates of the desired motion.
    pub fn advance(&mut self, desired_rates: &[Rate; COMPONENTS]) -> &[Yielding; COMPONENTS] {
        self.prepare();
        let tared = self.conditioner.tared();
        for (component, axis) in self.axes.iter_mut().enumerate() {
            let push = Push {
                force: axis.extremes.peak(),
                desired_rate: desired_rates[component],
                active: tared && self.mask & (1 << component) != 0,
                held: self.held,
                level: axis.guard.level(),
                touching: axis.guard.touching(),
            };
            self.yielding[component] = axis.compliance.advance(&push);
        }
        &self.yielding
    }

    /// Works out one level of one law that was changed: some 2000 instructions in a period.
    fn prepare(&mut self) {
        for axis in &mut self.axes {
            let Some(preparing) = &mut axis.preparing else {
                continue;
            };
            if preparing.next < LEVELS {
                preparing.law.prepare(preparing.next, self.period_us);
                preparing.next += 1;
            } else {
                axis.compliance.adopt(preparing.law.clone());
                axis.preparing = None;
            }
            return;
        }
    }

    /// The reference p_d + p_c was refused: takes the displacements of this period back. Try once more with these; if that is refused too, it is p_d that cannot be.
    pub fn withhold(&mut self) -> &[Yielding; COMPONENTS] {
        for (axis, yielding) in self.axes.iter_mut().zip(&mut self.yielding) {
            *yielding = axis.compliance.withhold();
        }
        &self.yielding
    }

    /// Other settings of one axis; in force some periods later, without a jump of the tool.
    ///
    /// # Errors
    /// What is wrong, with its bound; nothing changes.
    pub fn set(&mut self, component: usize, settings: &LoopSettings) -> Result<(), Refused> {
        let range = self.conditioner.sensor().range(component);
        let Some(axis) = self.axes.get_mut(component) else {
            return Err(Refused {
                parameter: Parameter::Axis,
                bound: COMPONENTS as i32 - 1,
            });
        };
        if axis.preparing.is_some() {
            return Err(Refused {
                parameter: Parameter::Busy,
                bound: 0,
            });
        }
        let law = Law::begin(settings, self.period_us, self.delay_us, range)?;
        axis.preparing = Some(Preparing { law, next: 1 });
        Ok(())
    }

    /// The settings of an axis that are in force.
    #[must_use]
    pub fn settings(&self, component: usize) -> Option<&LoopSettings> {
        self.axes
            .get(component)
            .map(|axis| axis.compliance.law().settings())
    }

    /// Which axes are under force control: bit 0 for x. An axis that is taken out returns to the desired position at f_d / K_V.
    pub const fn set_mask(&mut self, mask: u8) {
        self.mask = mask & ((1 << COMPONENTS) - 1);
    }

    /// Which axes are under force control.
    #[must_use]
    pub const fn mask(&self) -> u8 {
        self.mask
    }

    /// The displacements stay what they are (the rates end within some periods), or not any longer: for a stop whose reason is the sensor. A tool that returned would go blindly into the work.
    pub const fn hold(&mut self, held: bool) {
        self.held = held;
    }

    /// The tool stands where it is desired: after wanted became measured. The sensor must show its sign again.
    pub fn reset(&mut self) {
        self.held = false;
        for axis in &mut self.axes {
            axis.compliance.reset();
            axis.guard.reset(true);
        }
        self.yielding = [Yielding::default(); COMPONENTS];
    }

    /// Begins a tare; the peaks go on meanwhile. Not while the tool may touch something: that is for the caller to know.
    pub fn begin_tare(&mut self) {
        self.conditioner.begin_tare();
        for axis in &mut self.axes {
            axis.guard.reset(true);
        }
    }

    /// The sensor, its zero and its forces.
    #[must_use]
    pub const fn conditioner(&self) -> &Conditioner {
        &self.conditioner
    }

    /// Highest and lowest force of the last revolution.
    #[must_use]
    pub fn extremes(&self) -> [Extremes; COMPONENTS] {
        self.axes.each_ref().map(|axis| axis.extremes)
    }

    /// What the axes did in this period.
    #[must_use]
    pub const fn yielding(&self) -> &[Yielding; COMPONENTS] {
        &self.yielding
    }

    /// p_c.
    #[must_use]
    pub fn displacements(&self) -> [Displacement; COMPONENTS] {
        self.axes
            .each_ref()
            .map(|axis| axis.compliance.displacement())
    }

    /// Levels of damping.
    #[must_use]
    pub fn levels(&self) -> [u8; COMPONENTS] {
        self.axes.each_ref().map(|axis| axis.guard.level() as u8)
    }
}
