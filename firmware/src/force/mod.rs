//! Force control: from the codes of a force sensor to the compliant displacement.
//!
//! This module implements two stages of the control cycle. *Measure* ([`ForceControl::measure`])
//! turns codes into forces on the tool ([`sensor`]) and their peak over a spindle revolution
//! ([`window_peak`]), and decides whether sensor and contact are valid. *Comply*
//! ([`ForceControl::advance`]) computes the compliant displacement p_c of x, y and z in workpiece
//! coordinates ([`admittance`], [`zero_order_hold`]), supervised by the contact-stability monitor
//! ([`stability`]). The reference of the kinematics is p_r = p_d + p_c (docs/control.md
//! (3.31)-(3.33)).
//!
//! | part | units | limits |
//! | --- | --- | --- |
//! | forces | 2^-16 N, reaction on the tool (docs/control.md 1.3) | +-2048 N |
//! | p_c | 2^-40 mm | 64 mm, or less by its settings |
//! | K_A, K_V | 2^-16 N s^2/mm, 2^-16 N s/mm | K_V T / K_A is 2^-18 to 1, at all levels |
//! | contact stiffness | N/mm | up to 1000, the range of the contact-stability monitor |
//!
//! Callers must pass the rate of the commanded motion to which p_c is added. With another rate, the
//! enable condition and the contact-stability monitor act on a motion that does not happen.

pub mod admittance;
mod config;
pub mod sensor;
pub mod stability;
pub mod window_peak;
pub mod zero_order_hold;

use crate::digest::{Constants, Digest, impl_digest};
use admittance::{AdmittanceAxis, AdmittanceLaw, Compliance, DrivingForce, LEVELS};
pub use config::{ForceConfig, LoopSettings};
use haptimill_math::force::Displacement;
use haptimill_math::{Angle, Coordinate, Rate};
pub use haptimill_protocol::force::{
    EnableCondition, ForceLoop, ForceParameter, ForceProblem, ForceRefusal, ForceTelemetry,
    TareRefusal,
};
use sensor::{COMPONENTS, Conditioner, ForceSample, is_force};
use stability::{Sign, StabilityMonitor};
use window_peak::{Extremes, SlidingMinMax, Window};

/// Admittance law in preparation, one damping level per control period.
#[derive(Debug, Clone)]
struct Preparing {
    law: AdmittanceLaw,
    next: usize,
}

/// State of one axis.
#[derive(Debug, Clone)]
struct AdmittanceChannel {
    peaks: SlidingMinMax,
    extremes: Extremes,
    compliance: AdmittanceAxis,
    stability_monitor: StabilityMonitor,
    preparing: Option<Preparing>,
    /// Control periods until the next update of the contact-stability monitor.
    until_look: u16,
}

impl_digest!(AdmittanceChannel { fields {}, nested { compliance }, skip { peaks, extremes, stability_monitor, preparing, until_look } });

/// Force control of a machine.
#[derive(Debug, Clone)]
pub struct ForceControl {
    slowest_rpm: u16,
    /// Control periods between two updates of the monitor without teeth; 0 with teeth.
    toothless_update: u16,
    period_us: u16,
    delay_us: u32,
    creep: Rate,
    conditioner: Conditioner,
    axes: [AdmittanceChannel; COMPONENTS],
    mask: u8,
    rpm: i16,
    /// Control periods since the spindle was switched off.
    stopped: u16,
    /// Hold the compliant displacement, because the forces are invalid.
    held: bool,
    /// Force control is disabled on all axes for now.
    suspended: bool,
    /// The overload was present before the machine began to move.
    known: bool,
    /// A law was adopted in this control period.
    adopted: bool,
    condition: Option<ForceProblem>,
    compliance: [Compliance; COMPONENTS],
    /// The *comply* stage is inactive: no axis is under force control, all displacements are 0, and
    /// no law is in preparation.
    is_inactive: bool,
}

impl_digest!(ForceControl { fields { slowest_rpm, toothless_update, period_us, delay_us, creep }, nested { conditioner }, skip { axes, mask, rpm, stopped, held, suspended, known, adopted, condition, compliance, is_inactive } });

/// Values computed from a configuration before it is activated.
#[derive(Debug, Clone)]
pub struct Design {
    window: Window,
    laws: [AdmittanceLaw; COMPONENTS],
}

impl Design {
    /// Checks a configuration and computes its admittance laws: some 10^5 instructions.
    ///
    /// # Errors
    ///
    /// Returns the axis, if the error concerns one, and the refused parameter with its bound.
    #[cold]
    #[inline(never)]
    pub fn new(
        config: &ForceConfig,
        period_us: u16,
    ) -> Result<Self, (Option<usize>, ForceRefusal)> {
        let refuse = |parameter, bound| (None, ForceRefusal { parameter, bound });
        if !config.sensor.is_sound() {
            return Err(refuse(ForceParameter::Sensor, 0));
        }
        if config.mask >> COMPONENTS != 0 {
            return Err(refuse(ForceParameter::Axis, COMPONENTS as i32 - 1));
        }
        let Some(window) = config.window(period_us) else {
            // A revolution must fit 2048 samples.
            let bound = 60_000_000 / (2048 * i32::from(period_us.max(1))) + 1;
            return Err(refuse(ForceParameter::SlowestSpindle, bound));
        };
        let delay_us = config.delay_us(period_us);
        let law = |component: usize| {
            let range = config.sensor.range(component);
            AdmittanceLaw::new(&config.axes[component], period_us, delay_us, range)
                .map(|law| law.resting_below(config.creep, period_us))
                .map_err(|refusal| (Some(component), refusal))
        };
        Ok(Self {
            window,
            laws: [law(0)?, law(1)?, law(2)?],
        })
    }
}

/// Run-down time of the spindle after it is switched off, microseconds.
const RUN_DOWN_US: u32 = 1_000_000;

impl ForceControl {
    /// Creates the force control of a configuration.
    ///
    /// # Errors
    ///
    /// Returns the axis, if the error concerns one, and the refused parameter with its bound.
    pub fn new(
        config: &ForceConfig,
        period_us: u16,
    ) -> Result<Self, (Option<usize>, ForceRefusal)> {
        Ok(Self::of(config, Design::new(config, period_us)?, period_us))
    }

    /// Creates the force control of a checked configuration.
    #[must_use]
    pub fn of(config: &ForceConfig, design: Design, period_us: u16) -> Self {
        let Design { window, laws } = design;
        let mut until_look = 0;
        Self {
            conditioner: Conditioner::new(&config.sensor),
            axes: laws.map(|law| {
                until_look += 1;
                AdmittanceChannel {
                    peaks: SlidingMinMax::new(window),
                    extremes: Extremes::default(),
                    compliance: AdmittanceAxis::new(law),
                    stability_monitor: StabilityMonitor::default(),
                    preparing: None,
                    until_look,
                }
            }),
            mask: config.mask,
            slowest_rpm: config.slowest_rpm,
            toothless_update: config.toothless_update(period_us),
            delay_us: config.delay_us(period_us),
            creep: config.creep,
            period_us,
            rpm: 0,
            stopped: 0,
            held: false,
            suspended: false,
            known: false,
            adopted: false,
            condition: None,
            compliance: [Compliance::default(); COMPONENTS],
            is_inactive: false,
        }
    }

    /// Runs the *measure* stage with the sample of this control period, the commanded spindle
    /// speed, the measured position of the tool (the commanded one without a verified pose), the
    /// rotation of the workpiece, and whether the tool is unloaded.
    #[inline]
    pub fn measure(
        &mut self,
        sample: &ForceSample,
        spindle_rpm: i16,
        position: &[Coordinate; COMPONENTS],
        rotation: [Angle; 2],
        unloaded: bool,
    ) {
        if spindle_rpm != self.rpm {
            self.turn(spindle_rpm);
        }
        self.stopped = if spindle_rpm == 0 {
            self.stopped.saturating_add(1)
        } else {
            0
        };
        let mut found = self.conditioner.take(sample, unloaded);
        let forces = *self.conditioner.forces();
        for component in 0..COMPONENTS {
            let axis = &mut self.axes[component];
            axis.extremes = axis.peaks.push(forces[component]);
            let window = axis.peaks.window().samples();
            if self.toothless_update > 0 && u32::from(axis.until_look) == window {
                // The deepest position of the window of the peak, and of no other time.
                axis.stability_monitor.clear_positions();
            }
            axis.stability_monitor.record_position(position[component]);
            axis.until_look = axis.until_look.saturating_sub(1);
            if axis.until_look == 0 {
                axis.until_look = match self.toothless_update {
                    0 => (window / 4).max(1) as u16,
                    periods => periods,
                };
                let is_displaced = axis.compliance.displacement() != Displacement::default();
                let across = self.extent_across(component);
                let axis = &mut self.axes[component];
                axis.stability_monitor.update(
                    axis.extremes.peak(),
                    axis.compliance.law(),
                    is_displaced,
                    across,
                );
                if component == 0 {
                    self.conditioner.set_rotation(rotation);
                }
            }
            let sign = self.axes[component].stability_monitor.sign();
            if sign == Sign::Wrong && self.mask & (1 << component) != 0 {
                found = found.or(Some(ForceProblem::WrongSign {
                    component: component as u8,
                }));
            }
        }
        if self.mask != 0 && self.rpm != 0 && self.rpm.unsigned_abs() < self.slowest_rpm {
            found = found.or(Some(ForceProblem::SlowSpindle { rpm: self.rpm }));
        }
        self.condition = found;
    }

    /// Larger range of the measured position in the last revolution along the two axes other than
    /// this one, 2^-20 mm.
    fn extent_across(&self, component: usize) -> i32 {
        let others = (0..COMPONENTS).filter(|&other| other != component);
        let extents = others.map(|other| self.axes[other].stability_monitor.extent());
        extents.max().unwrap_or(0)
    }

    /// Adapts the window to another spindle speed. A stopped spindle keeps its window, as does a
    /// tool without teeth.
    #[cold]
    #[inline(never)]
    fn turn(&mut self, rpm: i16) {
        self.rpm = rpm;
        if self.slowest_rpm == 0 || rpm.unsigned_abs() < self.slowest_rpm {
            return;
        }
        if let Some(window) = Window::revolution(rpm, self.period_us) {
            self.axes
                .iter_mut()
                .for_each(|axis| axis.peaks.set_window(window));
        }
    }

    /// Whether the tool is known to be unloaded; `active` while anything moves or may move.
    ///
    /// The answer decides whether a mean force counts as drift. A cut and a displaced tool are
    /// loads, so the spindle must have been off for its run-down time, and all displacements must
    /// be 0. While the machine moves, a force of half the force setpoint counts as a contact; drift
    /// is found before it reaches that force. At standstill it does not: a large zero error and an
    /// object that leans on the tool must both be removed before a job begins.
    #[must_use]
    #[inline]
    pub fn unloaded(&self, active: bool) -> bool {
        u32::from(self.stopped) >= RUN_DOWN_US / u32::from(self.period_us.max(1))
            && !self.displaced()
            && !(active
                && self
                    .axes
                    .iter()
                    .any(|axis| axis.stability_monitor.touching()))
    }

    /// The problem of sensor or contact in this control period.
    #[must_use]
    pub const fn condition(&self) -> Option<ForceProblem> {
        self.condition
    }

    /// Whether the sensor is valid: it has no problem except a large force.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        self.condition.as_ref().is_none_or(is_force)
    }

    /// The condition that must stop a moving machine; `jogged` while the operator jogs it.
    ///
    /// A force beyond its limit always stops the machine, with one exception: the operator may jog
    /// away from an overload that was already present. Without a tare an overload of the sensor
    /// does not count. An invalid sensor stops the machine only under force control.
    #[must_use]
    #[inline]
    pub fn stop_condition(&self, jogged: bool) -> Option<ForceProblem> {
        let problem = self.condition?;
        let counts = if is_force(&problem) {
            let measured = matches!(problem, ForceProblem::Limit { .. });
            (measured || self.conditioner.tared()) && !(jogged && self.known)
        } else {
            self.mask != 0 && !self.suspended
        };
        counts.then_some(problem)
    }

    /// Updates the overload monitor; callers must call it in every control period. Motion cancels a
    /// tare. An overload already present at the start of motion is remembered.
    #[inline]
    pub fn update_overload(&mut self, active: bool) {
        let large = self.condition.as_ref().is_some_and(is_force);
        self.known = large && (self.known || !active);
        if active {
            self.conditioner.interrupt_tare();
        }
    }

    /// Takes the result of a tare.
    #[inline]
    pub const fn take_tare_result(&mut self) -> Option<Result<(), TareRefusal>> {
        self.conditioner.take_tare_result()
    }

    /// Runs one control period of the *comply* stage with the rates of the commanded motion.
    pub fn advance(&mut self, commanded_rates: &[Rate; COMPONENTS]) -> &[Compliance; COMPONENTS] {
        self.prepare();
        let tared = self.conditioner.tared();
        for (component, axis) in self.axes.iter_mut().enumerate() {
            let active = tared && !self.suspended && self.mask & (1 << component) != 0;
            if !active && axis.compliance.is_at_rest() {
                // No driving force, and no displacement to return from.
                self.compliance[component] = Compliance::default();
                continue;
            }
            let push = DrivingForce {
                force: axis.extremes.peak(),
                commanded_rate: commanded_rates[component],
                active,
                held: self.held,
                level: axis.stability_monitor.level(),
                touching: axis.stability_monitor.touching(),
            };
            self.compliance[component] = axis.compliance.advance(&push);
        }
        self.is_inactive = self.mask == 0
            && !self.adopted
            && (self.axes.iter())
                .all(|axis| axis.preparing.is_none() && axis.compliance.is_at_rest());
        &self.compliance
    }

    /// Whether no axis is under force control, all displacements are 0, and no settings wait.
    /// [`ForceControl::advance`] would then change nothing, and callers may skip it.
    #[must_use]
    pub const fn is_inactive(&self) -> bool {
        self.is_inactive
    }

    /// Computes one damping level of one changed law: some 2000 instructions per control period.
    fn prepare(&mut self) {
        self.adopted = false;
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
                self.adopted = true;
            }
            return;
        }
    }

    /// Rolls back the displacements of this control period after the reference p_d + p_c was
    /// refused. Callers must try again with these displacements; if the reference is refused again,
    /// p_d itself is not reachable.
    pub fn roll_back(&mut self) -> &[Compliance; COMPONENTS] {
        for (axis, compliance) in self.axes.iter_mut().zip(&mut self.compliance) {
            *compliance = axis.compliance.roll_back();
        }
        &self.compliance
    }

    /// Clamps the displacement of one axis to `max`.
    pub fn clamp_displacement(&mut self, component: usize, max: Displacement) {
        if let Some(axis) = self.axes.get_mut(component) {
            self.compliance[component] = axis.compliance.clamp_displacement(max);
        }
    }

    /// Runs one control period with the drives off: resets the compliant displacement.
    pub fn release(&mut self) {
        self.prepare();
        if self.displaced() || self.held {
            self.reset();
        }
    }

    /// Whether any compliant displacement differs from 0.
    #[must_use]
    #[inline]
    pub fn displaced(&self) -> bool {
        self.axes
            .iter()
            .any(|axis| axis.compliance.displacement() != Displacement::default())
    }

    /// Whether any compliant displacement changes.
    #[must_use]
    pub fn moves(&self) -> bool {
        self.compliance
            .iter()
            .any(|compliance| compliance.rate != Rate::ZERO)
    }

    /// Resets the contact, so that the sensor must confirm its sign again.
    pub fn reset_contact(&mut self) {
        for axis in &mut self.axes {
            axis.stability_monitor.reset(true);
        }
    }

    /// Changes the settings of one axis. They take effect some control periods later, without a
    /// jump of the tool.
    ///
    /// # Errors
    ///
    /// Returns the refused parameter with its bound; nothing changes.
    pub fn set(&mut self, component: usize, settings: &LoopSettings) -> Result<(), ForceRefusal> {
        let range = self.conditioner.sensor().range(component);
        let Some(axis) = self.axes.get_mut(component) else {
            return Err(ForceRefusal {
                parameter: ForceParameter::Axis,
                bound: COMPONENTS as i32 - 1,
            });
        };
        if axis.preparing.is_some() {
            return Err(ForceRefusal {
                parameter: ForceParameter::Busy,
                bound: 0,
            });
        }
        let law = AdmittanceLaw::begin(settings, self.period_us, self.delay_us, range)?
            .resting_below(self.creep, self.period_us);
        axis.preparing = Some(Preparing { law, next: 1 });
        self.is_inactive = false;
        Ok(())
    }

    /// The active settings of an axis.
    #[must_use]
    pub fn settings(&self, component: usize) -> Option<&LoopSettings> {
        self.axes
            .get(component)
            .map(|axis| axis.compliance.law().settings())
    }

    /// Selects the axes under force control: bit 0 for x. A deselected axis returns to the
    /// commanded position at f_d / K_V.
    pub const fn set_mask(&mut self, mask: u8) {
        self.is_inactive = false;
        self.mask = mask & ((1 << COMPONENTS) - 1);
    }

    /// The axes under force control: bit 0 for x.
    #[must_use]
    pub const fn mask(&self) -> u8 {
        self.mask
    }

    /// Holds the displacements (their rates end within some control periods), or releases them, for
    /// a stop caused by the sensor. A returning tool would move blindly into the workpiece.
    pub const fn hold(&mut self, held: bool) {
        self.held = held;
    }

    /// Disables force control on all axes for now (during the index search of homing);
    /// displacements only return.
    pub const fn suspend(&mut self, suspended: bool) {
        self.suspended = suspended;
    }

    /// Resets the compliant displacement after the commanded position became the measured one. The
    /// sensor must confirm its sign again.
    pub fn reset(&mut self) {
        self.held = false;
        for axis in &mut self.axes {
            axis.compliance.reset();
            axis.stability_monitor.reset(true);
        }
        self.compliance = [Compliance::default(); COMPONENTS];
    }

    /// Begins a tare; the peaks continue meanwhile. Callers must ensure that the tool touches
    /// nothing.
    pub fn begin_tare(&mut self) {
        self.conditioner.begin_tare();
        for axis in &mut self.axes {
            axis.stability_monitor.reset(true);
        }
    }

    /// The sensor, its zero and its forces.
    #[must_use]
    pub const fn conditioner(&self) -> &Conditioner {
        &self.conditioner
    }

    /// Highest and lowest force of the last spindle revolution.
    #[must_use]
    pub fn extremes(&self) -> [Extremes; COMPONENTS] {
        self.axes.each_ref().map(|axis| axis.extremes)
    }

    /// Compliant displacement of each axis, with its rates, in this control period.
    #[must_use]
    pub const fn compliance(&self) -> &[Compliance; COMPONENTS] {
        &self.compliance
    }

    /// Compliant displacements p_c.
    #[must_use]
    pub fn displacements(&self) -> [Displacement; COMPONENTS] {
        self.axes
            .each_ref()
            .map(|axis| axis.compliance.displacement())
    }

    /// Adds the constants of one axis to a digest. They change after [`ForceControl::set`]: see
    /// [`ForceControl::adopted`].
    pub fn digest_axis(&self, component: usize, digest: &mut Digest) {
        if let Some(axis) = self.axes.get(component) {
            Constants::digest(axis, digest);
        }
    }

    /// Whether the settings of an axis took effect in this control period.
    #[must_use]
    pub const fn adopted(&self) -> bool {
        self.adopted
    }

    /// Force telemetry.
    #[must_use]
    pub fn telemetry(&self) -> ForceTelemetry {
        let extremes = self.extremes();
        ForceTelemetry {
            high: extremes.map(|extremes| extremes.peak().0),
            low: extremes.map(|extremes| extremes.other().0),
            displacement: self.displacements().map(|by| by.length().0),
            mask: self.mask,
            tared: self.conditioner.tared(),
            problem: self.condition,
        }
    }

    /// Damping levels.
    #[must_use]
    pub fn levels(&self) -> [u8; COMPONENTS] {
        self.axes
            .each_ref()
            .map(|axis| axis.stability_monitor.level() as u8)
    }
}
