//! The controller: one function, called once per control period.
//!
//! The stages run once per control period, in this order. A stage uses the results of the stages
//! before it and the state that the previous period left.
//!
//! | stage | what it does | where |
//! | --- | --- | --- |
//! | receive | at most one request or setpoint | `comm/server.rs` |
//! | measure | encoder counts to joint positions, force samples to the force on the tool | `machine.rs` |
//! | supervise | fault checks in a fixed order; named inputs | `faults.rs`, `reactions.rs` |
//! | command | out-of-band stop; then a request or setpoint (refused: no change) | `commands.rs` |
//! | interpolate | the commanded pose of this period | `modes.rs` |
//! | comply | compliant displacement of force control | `machine/compliance.rs` |
//! | solve | volumetric compensation, inverse kinematics: joint motion | `machine.rs` |
//! | servo | position loops and step generation | `machine.rs` |
//! | render | force feedback to the haptic arm | `machine/masters.rs` |
//! | report | answers, events, telemetry | `comm/server.rs` |
//! | interlock | drives, spindle, haptic arm off by state; named outputs | here, `reactions.rs` |

use crate::comm::server::{Incoming, Server};
use crate::comm::telemetry;
use crate::core::Core;
use crate::faults::{self, DIGEST_OVERDUE};
use crate::force::ForceProblem;
use crate::io::{Inputs, Outputs};
use crate::machine::Machine;
use crate::motion::interpolator::QUEUE;
use crate::profiler::{Profiler, Stage};
use crate::safety::Safety;
use crate::volumetric::Fade;
use crate::{commands, modes, reactions};
use haptimill_protocol::link::Identity;
use haptimill_protocol::message::{Event, Fault, Refusal, State};

/// Time after an out-of-band stop in which commands that start motion are refused, microseconds. It
/// is longer than the resend time of the link, so a command that was sent before the stop has
/// arrived.
const STALE_COMMANDS_US: u64 = 450_000;

/// The controller. A board calls [`Controller::tick`] once per control period.
#[derive(Debug)]
pub struct Controller {
    server: Server,
    core: Core,
}

impl Controller {
    /// A controller without a configuration, for a control period of `period_us` microseconds.
    #[must_use]
    #[inline(never)]
    pub fn new(period_us: u16) -> Self {
        Self {
            server: Server::new(period_us),
            core: Core::new(period_us),
        }
    }

    /// One control period: from inputs latched at its start to outputs that take effect at the
    /// start of the next one.
    pub fn tick(&mut self, inputs: &Inputs, outputs: &mut Outputs, profiler: &mut impl Profiler) {
        let incoming = self.receive(inputs);
        profiler.mark(Stage::Receive);
        let Self { server, core } = self;

        #[cfg(feature = "defmt")]
        crate::log::inputs(core, inputs);
        core.measure(inputs);
        profiler.mark(Stage::Measure);

        faults::check(core, server, inputs);
        reactions::react(core, server);
        profiler.mark(Stage::Supervise);

        core.track_out_of_band_stop(inputs.out_of_band_stop);
        core.start_session(server.session_begun());
        if core.job.storing.is_some() {
            commands::follow_store(core, server, inputs);
        }
        match incoming {
            Some(Incoming::Request) => commands::execute(core, server, inputs),
            Some(Incoming::Setpoint { number, validated }) => {
                commands::enqueue_setpoint(core, server, number, validated);
            }
            Some(Incoming::BadSetpoint { number }) => {
                server.refuse_setpoints(Refusal::Setpoint { setpoint: number });
            }
            None => {}
        }
        profiler.mark(Stage::Command);

        modes::advance(core, server, inputs);
        profiler.mark(Stage::Interpolate);

        core.comply();
        profiler.mark(Stage::Comply);

        core.solve();
        profiler.mark(Stage::Solve);

        core.servo(outputs);
        profiler.mark(Stage::Servo);

        core.render(outputs);
        profiler.mark(Stage::Render);

        self.report(inputs, outputs);
        profiler.mark(Stage::Report);

        if !self.core.safety.drives_on() {
            outputs.make_safe();
        }
        reactions::write_outputs(&mut self.core, outputs);
        profiler.mark(Stage::Interlock);
    }

    /// Takes the bytes of this period, answers a Hello, and gives the next message.
    #[inline]
    fn receive(&mut self, inputs: &Inputs) -> Option<Incoming> {
        if self.server.take_bytes(inputs) {
            self.welcome();
        }
        let core = &mut self.core;
        core.job.busy = core.is_busy();
        // The link may get no time slice in a period that the interpolator, or an overdue
        // integrity check of the configuration, needs.
        let overdue = core.job.digest_backlog >= DIGEST_OVERDUE;
        self.server.next(core.job.busy || overdue)
    }

    #[inline(never)]
    fn welcome(&mut self) {
        // Another host may take over an active machine only while it decelerates for a fault.
        let busy = self.core.safety.active() && self.core.safety.pending().is_none();
        let machine = self.core.machine.as_ref();
        let identity = Identity {
            machine: machine.map_or("", |machine| &machine.config.name),
            config_crc: machine.map_or(0, |machine| machine.crc),
            period_us: self.core.period_us,
            axes: machine.map_or(0, |machine| machine.axes() as u8),
            queue: QUEUE as u16,
            kept: self.core.kept,
        };
        self.server.welcome(&identity, busy);
    }

    #[inline]
    fn report(&mut self, inputs: &Inputs, outputs: &mut Outputs) {
        self.server.transmit(
            inputs.period,
            &mut self.core.safety,
            inputs.transmit_room,
            &mut outputs.transmit,
        );
        let events = self.core.safety.has_events();
        if let Some(stream) = self.server.telemetry_due(events) {
            let line = self.server.counters();
            let message = telemetry::sample(&self.core, inputs, &line, stream);
            self.server.send_telemetry(stream, message.as_ref());
        }
    }

    /// Activates the configuration that the board keeps ([`crate::kept`]), or states that it keeps
    /// none. A board that can keep one calls it once, before the first period and with its counters
    /// at 0. A configuration that cannot be activated is ignored and reported to the host.
    pub fn restore(&mut self, kept: Option<&[u8]>) {
        commands::restore(&mut self.core, kept);
    }

    /// The configuration that the board must keep from now on, without its mark
    /// ([`crate::kept::prefix`]). It is returned after the period in which the host requested it.
    /// From the next period on [`Inputs::storage`] says how far the board is.
    #[must_use]
    #[inline]
    pub fn to_store(&self) -> Option<&[u8]> {
        let is_new = self.core.job.storing.is_some_and(|it| it.is_new);
        is_new.then(|| self.server.staged())
    }

    /// The configured machine, for recorders and tests.
    #[must_use]
    pub const fn machine(&self) -> Option<&Machine> {
        self.core.machine.as_ref()
    }

    /// State and faults, for recorders and tests.
    #[must_use]
    pub const fn safety(&self) -> &Safety {
        &self.core.safety
    }

    /// Commanded spindle speed, rev/min.
    #[must_use]
    pub fn spindle_rpm(&self) -> i16 {
        self.core.spindle_rpm()
    }
}

/// The stages that belong to the configured machine.
impl Core {
    /// Encoders to joint positions, force samples to the force on the tool.
    #[inline]
    fn measure(&mut self, inputs: &Inputs) {
        let spindle_rpm = self.spindle_rpm();
        if let Some(machine) = &mut self.machine {
            machine.measure(inputs);
            machine.measure_force(inputs, spindle_rpm, self.safety.active());
        } else {
            self.power_on.update(inputs, self.period_us);
        }
    }

    /// An out-of-band stop holds the machine. Commands that start motion are then refused for
    /// [`STALE_COMMANDS_US`], or until `Hold`, `Stop` or a new session.
    #[inline]
    fn track_out_of_band_stop(&mut self, stop: bool) {
        if stop {
            self.hold();
            self.job.stale_commands = true;
            self.job.since_out_of_band_stop = 0;
        } else if self.job.stale_commands {
            self.job.since_out_of_band_stop = self.job.since_out_of_band_stop.saturating_add(1);
            let elapsed = u64::from(self.job.since_out_of_band_stop) * u64::from(self.period_us);
            self.job.stale_commands = elapsed < STALE_COMMANDS_US;
        }
    }

    /// A new session numbers its jogs and master poses anew. The source of each coordinate and the
    /// overrides are reset as soon as the machine is not active.
    #[inline]
    fn start_session(&mut self, begun: bool) {
        if begun {
            self.job.jog_epoch = None;
            self.job.jog_cancelled = false;
            self.job.master_epoch = None;
            self.job.master_cancelled = false;
            self.job.stale_commands = false;
            self.job.new_session = true;
            self.job.enabling = 0;
            if let Some(storing) = &mut self.job.storing {
                storing.id = None;
            }
            if let Some(machine) = &mut self.machine {
                machine.masters.remote.reset();
            }
        }
        if self.job.new_session && !self.safety.active() {
            self.reset_sources();
        }
    }

    #[inline(never)]
    fn reset_sources(&mut self) {
        self.job.new_session = false;
        if let Some(machine) = &mut self.machine {
            machine.motion.reset_sources();
            machine.motion.program.set_override(100);
            machine.motion.program.set_rapid_override(100);
        }
        self.job.spindle_percent = 100;
    }

    /// Admittance control: the compliant displacement of this period.
    #[inline]
    fn comply(&mut self) {
        let Some(machine) = &mut self.machine else {
            return;
        };
        if !self.safety.drives_on() {
            machine.release_force();
            return;
        }
        let frozen = match (self.safety.fault(), self.safety.pending()) {
            (Some(Fault::Force(_)), _) => true,
            // During the deceleration for a force beyond its limit the tool keeps its compliance.
            (_, Some(Fault::Force(problem))) => !matches!(problem, ForceProblem::Limit { .. }),
            _ => machine.is_locking(),
        };
        machine.comply(frozen, self.safety.state() == State::Homing);
    }

    /// Volumetric compensation and inverse kinematics of the reference, and the limits that apply
    /// to the result.
    #[inline]
    fn solve(&mut self) {
        let Some(machine) = &mut self.machine else {
            return;
        };
        let is_homed = self.safety.homed();
        let fade = match self.safety.state() {
            State::Fault => Fade::Frozen,
            State::Homing => Fade::Out,
            _ if is_homed => Fade::In,
            _ => Fade::Out,
        };
        machine.fade_compensation(self.safety.drives_on(), fade);
        if self.safety.drives_on() {
            if let Err(error) = machine.solve() {
                self.safety.raise(Fault::Pose(error));
            }
            machine.follow_gantries(is_homed);
            if let Some(joint) = machine.joint_beyond_rate() {
                self.safety.raise(Fault::JointRate {
                    setpoint: machine.motion.program.reached(),
                    joint: joint as u8,
                    rate: machine.target().rates[joint].0,
                    limit: machine.kinematics.rates()[joint].0,
                });
            }
        }
        while let Some(axis) = machine.take_limited() {
            self.safety.push_event(Event::ComplianceLimited { axis });
        }
    }

    /// Position loops and step generation. The first saturation of each joint since enable or job
    /// start is an event.
    #[inline]
    fn servo(&mut self, outputs: &mut Outputs) {
        outputs.spindle_rpm = self.spindle_rpm();
        let Some(machine) = &mut self.machine else {
            return;
        };
        if !self.safety.drives_on() {
            machine.disable();
        }
        let saturated = machine.servo(&mut outputs.joints);
        if let Some(joint) = saturated
            && self.job.saturated & (1 << joint) == 0
        {
            self.job.saturated |= 1 << joint;
            self.safety.push_event(Event::Saturated { joint });
        }
    }

    /// Force feedback to the haptic arm.
    #[inline]
    fn render(&mut self, outputs: &mut Outputs) {
        let powered = self.safety.drives_on() && self.safety.state() != State::Fault;
        if let Some(machine) = &mut self.machine {
            machine.render(powered, &mut outputs.haptic);
        }
    }
}
