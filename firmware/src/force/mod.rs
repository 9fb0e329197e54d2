//! Force control: from the codes of a force sensor to the displacement by which the tool yields.
//!
//! Two stages of the corridor are here. *Sense* ([`ForceControl::measure`]): codes to forces on the tool ([`conditioning`]), their peak over a revolution of the spindle ([`peak`]), and whether sensor and
//! contact can be believed. *Yield* ([`ForceControl::advance`]): the compliant displacement p_c of x, y and z of the work ([`compliance`], [`pole`]) under the eye of [`stability_monitor`]; the reference of
//! the kinematics is p_r = p_d + p_c (docs/control.md (3.31)-(3.33)).
//!
//! | part | units | limits |
//! | --- | --- | --- |
//! | forces | 2^-16 N, reaction on the tool (docs/control.md 1.3) | +-2048 N |
//! | p_c | 2^-40 mm | 64 mm, or less by its settings |
//! | K_A, K_V | 2^-16 N s^2/mm, 2^-16 N s/mm | 2^-18 <= K_V T / K_A, and K_A >= K_V T at the highest level of damping |
//! | stiffness of the contact | N/mm | the guard answers for 1000 |
//!
//! Misuse: feeding a desired rate that is not the one that is added. The gate and the guard would act for a motion that does not happen.

pub mod admittance;
pub mod sensor;
pub mod stability;
pub mod window_peak;
pub mod zero_order_hold;

use crate::config::digest::{Constants, Digest, constants};
use admittance::{AdmittanceAxis, AdmittanceLaw, DrivingForce, LEVELS, Yielding};
use haptimill_math::force::{Displacement, Force, VirtualDamping, VirtualMass};
use haptimill_math::{Angle, Coordinate, Length, Rate};
pub use haptimill_protocol::force::{
    ForceLoop, ForceParameter, ForceProblem, ForceRefusal, ForceTelemetry, Gate, TareRefusal,
};
use sensor::{COMPONENTS, Conditioner, ForceSample, Sensor, is_force};
use serde::{Deserialize, Serialize};
use stability::{Sign, StabilityMonitor};
use window_peak::{Extremes, SlidingMinMax, Window};

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

impl From<&ForceLoop> for LoopSettings {
    fn from(settings: &ForceLoop) -> Self {
        Self {
            desired: Force(settings.desired),
            mass: VirtualMass(settings.mass),
            damping: VirtualDamping(settings.damping),
            limit: Length(settings.limit),
            rate: Rate(settings.rate),
            gate: settings.gate,
        }
    }
}

impl From<&LoopSettings> for ForceLoop {
    fn from(settings: &LoopSettings) -> Self {
        Self {
            desired: settings.desired.0,
            mass: settings.mass.0,
            damping: settings.damping.0,
            limit: settings.limit.0,
            rate: settings.rate.0,
            gate: settings.gate,
        }
    }
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
    /// The slowest rate at which the drives follow their reference, in spite of friction and lost motion: on a stiff contact the tool moves as fast or rests. 0 for drives that follow at any rate.
    pub creep: Rate,
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
    law: AdmittanceLaw,
    next: usize,
}

/// One axis.
#[derive(Debug, Clone)]
struct Axis {
    peaks: SlidingMinMax,
    extremes: Extremes,
    compliance: AdmittanceAxis,
    stability_monitor: StabilityMonitor,
    preparing: Option<Preparing>,
    /// Periods until the next look.
    until_look: u16,
}

constants!(Axis {} of { compliance } but { peaks, extremes, stability_monitor, preparing, until_look });

/// Force control of a machine.
#[derive(Debug, Clone)]
pub struct ForceControl {
    slowest_rpm: u16,
    period_us: u16,
    delay_us: u32,
    creep: Rate,
    conditioner: Conditioner,
    axes: [Axis; COMPONENTS],
    mask: u8,
    rpm: i16,
    /// Periods since the spindle was switched off.
    stopped: u16,
    /// The tool stays where it is: the forces are not believed.
    held: bool,
    /// No axis is under force control for the time being.
    suspended: bool,
    /// A force that is too large was there before the machine began to move.
    known: bool,
    /// A law was adopted in this period.
    adopted: bool,
    condition: Option<ForceProblem>,
    yielding: [Yielding; COMPONENTS],
    /// No axis is under force control, none has yielded, and no law is being worked out: there is nothing to do in *yield*.
    is_inactive: bool,
}

constants!(ForceControl { slowest_rpm, period_us, delay_us, creep } of { conditioner }
    but { axes, mask, rpm, stopped, held, suspended, known, adopted, condition, yielding, is_inactive });

/// What is worked out from a configuration before it is taken.
#[derive(Debug, Clone)]
pub struct Design {
    window: Window,
    laws: [AdmittanceLaw; COMPONENTS],
}

impl Design {
    /// Checks a configuration and works out its laws: some 10^5 instructions.
    ///
    /// # Errors
    /// The axis, if it is one's fault, and what is wrong.
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
            // 2048 samples hold a revolution.
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

/// How long a spindle runs on after it was switched off, microseconds.
const RUN_DOWN_US: u32 = 1_000_000;

impl ForceControl {
    /// The force control of a configuration.
    ///
    /// # Errors
    /// The axis, if it is one's fault, and what is wrong.
    pub fn new(
        config: &ForceConfig,
        period_us: u16,
    ) -> Result<Self, (Option<usize>, ForceRefusal)> {
        Ok(Self::of(config, Design::new(config, period_us)?, period_us))
    }

    /// The force control of a configuration that was checked.
    #[must_use]
    pub fn of(config: &ForceConfig, design: Design, period_us: u16) -> Self {
        let Design { window, laws } = design;
        let mut until_look = 0;
        Self {
            conditioner: Conditioner::new(&config.sensor),
            axes: laws.map(|law| {
                until_look += 1;
                Axis {
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
            yielding: [Yielding::default(); COMPONENTS],
            is_inactive: false,
        }
    }

    /// Stage *sense*: the sample of this period, the commanded speed of the spindle, where the tool was measured (or wanted, where there is no certified pose), the angle of the table, and
    /// whether nothing touches the tool.
    #[inline]
    pub fn measure(
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
        self.stopped = if spindle_rpm == 0 {
            self.stopped.saturating_add(1)
        } else {
            0
        };
        let mut found = self.conditioner.take(sample, unloaded);
        let forces = *self.conditioner.forces();
        for (component, axis) in self.axes.iter_mut().enumerate() {
            axis.extremes = axis.peaks.push(forces[component]);
            axis.stability_monitor.note(position[component]);
            axis.until_look = axis.until_look.saturating_sub(1);
            if axis.until_look == 0 {
                axis.until_look = (axis.peaks.window().samples() / 4).max(1) as u16;
                let yielded = axis.compliance.displacement() != Displacement::default();
                axis.stability_monitor
                    .look(axis.extremes.peak(), axis.compliance.law(), yielded);
                if component == 0 {
                    self.conditioner.set_table(table);
                }
            }
            if axis.stability_monitor.sign() == Sign::Wrong && self.mask & (1 << component) != 0 {
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

    /// Another speed of the spindle: another window. A standing spindle leaves the window as it was.
    #[cold]
    #[inline(never)]
    fn turn(&mut self, rpm: i16) {
        self.rpm = rpm;
        if rpm.unsigned_abs() < self.slowest_rpm {
            return;
        }
        if let Some(window) = Window::revolution(rpm, self.period_us) {
            self.axes
                .iter_mut()
                .for_each(|axis| axis.peaks.set_window(window));
        }
    }

    /// Whether nothing touches the tool, as far as it can be known; `active` while something moves or may move.
    ///
    /// The answer decides whether a mean force is called drift. A cut, or a tool that has yielded, is a load. So the spindle must have been off for as long as it runs on, and no axis
    /// may have yielded. While the machine moves a force of half the desired one is taken for a contact; drift is found on its way there. At rest it is not: a zero that wandered
    /// far, and something that leans on the tool, must both be gone before a job begins.
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

    /// What is wrong with sensor or contact in this period.
    #[must_use]
    pub const fn condition(&self) -> Option<ForceProblem> {
        self.condition
    }

    /// Whether the sensor can be believed: nothing is wrong with it but, at most, that the force is large.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        self.condition.as_ref().is_none_or(is_force)
    }

    /// What must stop a machine that moves; `jogged` says that a person moves it.
    ///
    /// A force beyond its limit stops always, except that a person may jog away from one that was there before: otherwise nobody could. A sensor that cannot be believed stops what is
    /// under force control; without force control, nothing hangs on it.
    #[must_use]
    #[inline]
    pub fn stop_condition(&self, jogged: bool) -> Option<ForceProblem> {
        let problem = self.condition?;
        let counts = if is_force(&problem) {
            self.conditioner.tared() && !(jogged && self.known)
        } else {
            self.mask != 0 && !self.suspended
        };
        counts.then_some(problem)
    }

    /// Minds whether the machine moves: a tare ends with it, and a force that is too large is known from before. To be told in every period.
    #[inline]
    pub fn update_overload(&mut self, active: bool) {
        let large = self.condition.as_ref().is_some_and(is_force);
        self.known = large && (self.known || !active);
        if active {
            self.conditioner.interrupt_tare();
        }
    }

    /// How a tare ended, once.
    #[inline]
    pub const fn take_tare_result(&mut self) -> Option<Result<(), TareRefusal>> {
        self.conditioner.take_tare_result()
    }

    /// Stage *yield*: one period of the loops with the rates of the desired motion.
    pub fn advance(&mut self, desired_rates: &[Rate; COMPONENTS]) -> &[Yielding; COMPONENTS] {
        self.prepare();
        let tared = self.conditioner.tared();
        for (component, axis) in self.axes.iter_mut().enumerate() {
            let active = tared && !self.suspended && self.mask & (1 << component) != 0;
            if !active && axis.compliance.is_at_rest() {
                // Nothing pushes it, and it has nowhere to return from.
                self.yielding[component] = Yielding::default();
                continue;
            }
            let push = DrivingForce {
                force: axis.extremes.peak(),
                desired_rate: desired_rates[component],
                active,
                held: self.held,
                level: axis.stability_monitor.level(),
                touching: axis.stability_monitor.touching(),
            };
            self.yielding[component] = axis.compliance.advance(&push);
        }
        self.is_inactive = self.mask == 0
            && !self.adopted
            && (self.axes.iter())
                .all(|axis| axis.preparing.is_none() && axis.compliance.is_at_rest());
        &self.yielding
    }

    /// Whether no axis is under force control, nothing has yielded, and no settings wait: then [`ForceControl::advance`] would change nothing, and need not be
    /// called.
    #[must_use]
    pub const fn is_inactive(&self) -> bool {
        self.is_inactive
    }

    /// Works out one level of one law that was changed: some 2000 instructions in a period.
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

    /// The reference p_d + p_c was refused: takes the displacements of this period back. Try once more with these; if that is refused too, it is p_d that cannot be.
    pub fn roll_back(&mut self) -> &[Yielding; COMPONENTS] {
        for (axis, yielding) in self.axes.iter_mut().zip(&mut self.yielding) {
            *yielding = axis.compliance.roll_back();
        }
        &self.yielding
    }

    /// One axis may have yielded no further than `most`: the rest is taken back.
    pub fn clamp_displacement(&mut self, component: usize, most: Displacement) {
        if let Some(axis) = self.axes.get_mut(component) {
            self.yielding[component] = axis.compliance.clamp_displacement(most);
        }
    }

    /// One period with the drives off: nothing is held where it yielded to.
    pub fn release(&mut self) {
        self.prepare();
        if self.displaced() || self.held {
            self.reset();
        }
    }

    /// Whether the tool has yielded.
    #[must_use]
    #[inline]
    pub fn displaced(&self) -> bool {
        self.axes
            .iter()
            .any(|axis| axis.compliance.displacement() != Displacement::default())
    }

    /// Whether the tool is yielding, or returning.
    #[must_use]
    pub fn moves(&self) -> bool {
        self.yielding
            .iter()
            .any(|yielding| yielding.rate != Rate::ZERO)
    }

    /// The sensor must show its sign again.
    pub fn forget_contact(&mut self) {
        for axis in &mut self.axes {
            axis.stability_monitor.reset(true);
        }
    }

    /// Other settings of one axis; in force some periods later, without a jump of the tool.
    ///
    /// # Errors
    /// What is wrong, with its bound; nothing changes.
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

    /// The settings of an axis that are in force.
    #[must_use]
    pub fn settings(&self, component: usize) -> Option<&LoopSettings> {
        self.axes
            .get(component)
            .map(|axis| axis.compliance.law().settings())
    }

    /// Which axes are under force control: bit 0 for x. An axis that is taken out returns to the desired position at f_d / K_V.
    pub const fn set_mask(&mut self, mask: u8) {
        self.is_inactive = false;
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

    /// No axis is under force control for the time being (while the machine looks for its references): the tool only returns.
    pub const fn suspend(&mut self, suspended: bool) {
        self.suspended = suspended;
    }

    /// The tool stands where it is desired: after wanted became measured. The sensor must show its sign again.
    pub fn reset(&mut self) {
        self.held = false;
        for axis in &mut self.axes {
            axis.compliance.reset();
            axis.stability_monitor.reset(true);
        }
        self.yielding = [Yielding::default(); COMPONENTS];
    }

    /// Begins a tare; the peaks go on meanwhile. Not while the tool may touch something: that is for the caller to know.
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

    /// Adds the constants of one axis to a digest. They change when settings were [changed](Self::set): see [`ForceControl::adopted`].
    pub fn digest_axis(&self, component: usize, digest: &mut Digest) {
        if let Some(axis) = self.axes.get(component) {
            Constants::digest(axis, digest);
        }
    }

    /// Whether the settings of an axis changed in this period.
    #[must_use]
    pub const fn adopted(&self) -> bool {
        self.adopted
    }

    /// How the forces stand, for telemetry.
    #[must_use]
    pub fn telemetry(&self) -> ForceTelemetry {
        let extremes = self.extremes();
        ForceTelemetry {
            high: extremes.map(|extremes| extremes.peak().0),
            low: extremes.map(|extremes| extremes.other().0),
            yielded: self.displacements().map(|by| by.length().0),
            mask: self.mask,
            tared: self.conditioner.tared(),
            problem: self.condition,
        }
    }

    /// Levels of damping.
    #[must_use]
    pub fn levels(&self) -> [u8; COMPONENTS] {
        self.axes
            .each_ref()
            .map(|axis| axis.stability_monitor.level() as u8)
    }
}
