//! Applies the stimuli of a script.

use super::{JogSender, MasterSender, PlayResult, Player};
use crate::fuzz::checks::{self, Cause};
use crate::fuzz::episode::{JOINTS, Stimulus, joint_of};
use crate::fuzz::files;
use crate::fuzz::rng::Rng;
use haptimill_hil_sim::fault::FaultKind;
use haptimill_hil_sim::operator::trajectory::{Live, Trajectory};
use haptimill_protocol::message::{AxisValues, Command};
use haptimill_protocol::out_of_band::STOP;

impl Player {
    #[allow(clippy::too_many_lines, reason = "one arm for each stimulus")]
    /// Applies a stimulus and runs the periods of its step.
    pub(super) fn apply(&mut self, stimulus: &Stimulus, periods: u32) -> PlayResult {
        match stimulus {
            Stimulus::Wait => {}
            Stimulus::Send(command) => {
                self.observe_command(command);
                self.bench.send(command);
            }
            Stimulus::Probe(command) => self.probe(command)?,
            Stimulus::Job(plan) => self.begin_job(plan),
            Stimulus::Jog {
                rates,
                timeout_ms,
                every,
                epoch,
                cancel,
            } => {
                self.epoch = self.epoch.wrapping_add(*epoch as u16);
                let limits = self.bench.machine.config.pose.iter();
                self.jog_sender = Some(JogSender {
                    rates: limits
                        .zip(rates)
                        .map(|(limit, part)| (f64::from(limit.rate.0) * part / 256.0) as i32)
                        .collect(),
                    timeout_ms: *timeout_ms,
                    every: u32::from(*every),
                    since: u32::from(*every),
                });
                self.steps(periods)?;
                self.jog_sender = None;
                if *cancel {
                    let cancel = Command::JogCancel { epoch: self.epoch };
                    self.bench.send(&cancel);
                }
                return self.steps(1500);
            }
            Stimulus::StaleJog => {
                let rates: AxisValues = (0..self.axes()).map(|_| 8192).collect();
                self.epoch = self.epoch.wrapping_add(2);
                let cancel = Command::JogCancel { epoch: self.epoch };
                self.bench.send(&cancel);
                for back in [0_u16, 1, 100] {
                    let jog = Command::Jog {
                        epoch: self.epoch.wrapping_sub(back),
                        timeout_ms: 100,
                        rates: rates.clone(),
                    };
                    self.bench.send(&jog);
                }
            }
            Stimulus::Recover => self.recover()?,
            Stimulus::WaitIdle => {
                self.wait_idle(periods)?;
                return self.steps(20);
            }
            Stimulus::NewSession => {
                self.stream.clear();
                self.jog_sender = None;
                self.checks.causes.push(Cause::HostSilent);
                self.bench.open_session();
                self.epoch = 0;
            }
            Stimulus::HostAway(away) => {
                self.checks.causes.push(Cause::HostSilent);
                if *away {
                    self.bench.away_since.get_or_insert(self.bench.period);
                } else if self.bench.away_since.take().is_some() {
                    self.stream.clear();
                }
            }
            Stimulus::OutOfBandStop => self.bench.inject(&STOP),
            Stimulus::Garbage(bytes) => {
                self.checks.causes.push(Cause::HostSilent);
                self.bench.inject(bytes);
            }
            Stimulus::LineNoise(noise) => {
                self.checks.causes.push(Cause::HostSilent);
                self.bench.set_noise(*noise);
            }
            Stimulus::EmergencyStopCircuit(open) => {
                self.checks.causes.push(Cause::EmergencyStop);
                self.bench.rig.plant_mut().set_emergency_stop(*open);
            }
            Stimulus::InjectFault(kind) => self.inject_fault(kind),
            Stimulus::RampLoad(joint, effort) => {
                if *joint >= self.bench.axes {
                    return self.steps(periods);
                }
                self.checks.record_fault(&FaultKind::Push {
                    joint: JOINTS[*joint].to_string(),
                    effort: *effort,
                });
                for period in 0..periods {
                    let part = f64::from(period + 1) / f64::from(periods);
                    self.bench.rig.plant_mut().set_load(*joint, effort * part);
                    self.step()?;
                }
                return Ok(());
            }
            Stimulus::ClearFaults => {
                self.bench.set_faults(vec![]);
                self.bench.rig.plant_mut().set_emergency_stop(false);
                if self.bench.away_since.take().is_some() {
                    self.stream.clear();
                }
            }
            Stimulus::MissPeriods(count) => {
                self.checks.causes.push(Cause::MissedPeriods);
                self.bench.rig.control_mut().late = *count;
            }
            Stimulus::VirtualFixture(wall) => self.set_wall(*wall),
            Stimulus::ClampStock => self.clamp_stock(),
            Stimulus::Configure {
                seed,
                mutations,
                preset,
            } => self.reconfigure(*seed, *mutations, *preset)?,
            Stimulus::MoveMaster(to, enabling_switch) => {
                self.checks.causes.push(Cause::MasterMoves);
                if let Some(arm) = self.bench.rig.plant_mut().haptic_mut() {
                    arm.set_trajectory(Trajectory::Live(Live {
                        place_mm: *to,
                        velocity_mm_s: [0.0; 3],
                        enabling_switch: *enabling_switch,
                    }));
                    arm.set_enabling_switch(*enabling_switch);
                }
            }
            Stimulus::RemoteMaster(seed, age_ms) => {
                self.checks.causes.push(Cause::MasterMoves);
                self.master_epoch = self.master_epoch.wrapping_add(1);
                self.master_sender = Some(MasterSender {
                    rng: Rng::new(*seed, 903),
                    age_ms: *age_ms,
                    phase: 0.0,
                    since: 25,
                });
                self.steps(periods)?;
                self.master_sender = None;
                return Ok(());
            }
            Stimulus::CorruptFile(seed) => {
                if let Err(text) = files::corrupt(*seed) {
                    return Err(self.violation("parser", text));
                }
            }
        }
        self.steps(periods)
    }

    /// Follows a command that is not part of the planned job.
    fn observe_command(&mut self, command: &Command) {
        if matches!(
            command,
            Command::Setpoints(_) | Command::JobStart { .. } | Command::JobEnd { .. }
        ) {
            self.checks.job.invalidate();
        }
        if matches!(command, Command::Stop | Command::EmergencyStop) {
            self.stream.clear();
        }
        if let Command::Jog { epoch, .. } | Command::JogCancel { epoch } = command {
            self.epoch = *epoch;
        }
    }

    fn inject_fault(&mut self, kind: &FaultKind) {
        self.checks.record_fault(kind);
        match kind {
            FaultKind::EncoderSlip {
                joint: axis,
                counts,
            } => {
                if let Some(joint) = joint_of(axis)
                    && joint < self.bench.axes
                {
                    self.bench.rig.plant_mut().slip_encoder(joint, *counts);
                }
            }
            kind => {
                let mut faults = self.bench.faults.clone();
                faults.push(kind.clone());
                self.bench.set_faults(faults);
            }
        }
    }

    /// Sends a command at standstill; a refusal must change nothing.
    fn probe(&mut self, command: &Command) -> PlayResult {
        for _ in 0..3000 {
            let idle = self.stream.is_empty()
                && self.bench.pending.is_empty()
                && self.jog_sender.is_none()
                && self.master_sender.is_none();
            if idle && checks::is_at_standstill(&self.bench) && self.bench.away_since.is_none() {
                break;
            }
            self.step()?;
        }
        if !checks::is_at_standstill(&self.bench) || !self.bench.pending.is_empty() {
            return Ok(());
        }
        self.steps(30)?;
        self.observe_command(command);
        let state = self.state();
        let session = self.bench.session_start;
        let before = checks::fingerprint(&self.bench);
        let result = self.ask(command, 3000)?;
        let moved = self.state() != state || self.bench.session_start != session;
        if let (Some(Err(refusal)), false) = (&result, moved) {
            let after = checks::fingerprint(&self.bench);
            if let Some(difference) = checks::difference(&before, &after) {
                return Err(self.violation(
                    "refused with side effects",
                    format!("{command:?} was refused ({refusal:?}), and {difference}"),
                ));
            }
        }
        Ok(())
    }
}
