//! Events and telemetry of the machine.

use super::{JOB, Report, Teleop, to_message_units};
use crate::outcome::{Ended, HoldRecord, Row};
use haptimill_client::session::{EMERGENCY_STOP, JobLine};
use haptimill_protocol::haptic::COMPONENTS;
use haptimill_protocol::message::{Event, State, Telemetry};

impl<L: JobLine> Teleop<'_, L> {
    pub(super) fn process_events(&mut self, report: &mut Report<'_>) {
        while let Some((_, event)) = self.session.events.get(self.next_event) {
            let event = event.clone();
            self.next_event += 1;
            let text = self.session.describe(&event);
            match &event {
                Event::MasterLost { .. } => {
                    let status = self.master.status();
                    self.master_lost = Some(match status.reason() {
                        Some(reason) => format!("{text} ({reason})"),
                        None => text.clone(),
                    });
                }
                Event::State { to, .. } => self.enter_state(*to),
                Event::JobDone { job: JOB, .. } => self.is_over = true,
                Event::JobDropped { job: JOB, .. } => {
                    self.is_over = true;
                    if self.outcome.ended == Ended::Done && !self.is_ending {
                        self.outcome.ended = Ended::Stopped;
                    }
                }
                Event::Fault(fault) => {
                    self.outcome.ended = Ended::Fault;
                    let fault = self.session.describe(fault);
                    self.outcome.faults.push(fault);
                }
                _ if !self.outcome.notes.contains(&text) => {
                    self.outcome.notes.push(text.clone());
                }
                _ => {}
            }
            report(None, Some(&text));
        }
    }

    fn enter_state(&mut self, to: State) {
        let at_s = self.time_s();
        if to == State::Hold && self.state == State::Run && !self.is_ending {
            self.unresumed = self.master_lost.take();
            let why = self.unresumed.clone();
            let why = why.unwrap_or_else(|| "a command asked for it".to_string());
            self.outcome.holds.push(HoldRecord {
                at_s,
                why,
                resumed_s: None,
            });
        }
        if to == State::Run {
            self.unresumed = None;
        }
        if to == State::Run
            && self.state == State::Hold
            && let Some(hold) = self.outcome.holds.last_mut()
        {
            hold.resumed_s = Some(at_s);
        }
        self.state = to;
    }

    /// Takes new telemetry of the machine, and sends the force on the tool to the master.
    pub(super) fn process_telemetry(&mut self) -> Option<Row> {
        let telemetry: Telemetry = self.session.client().telemetry()?.clone();
        if self.newest_period.replace(telemetry.period) == Some(telemetry.period) {
            return None;
        }
        let now_us = self.session.now_us();
        let measured = telemetry
            .force
            .as_ref()
            .filter(|force| force.tared && force.problem.is_none());
        let high = measured.map_or([0; COMPONENTS], |force| force.high);
        let tool_force = to_message_units(&high);
        if !self.has_machine_snapshot {
            let round_trip_us = u64::from(self.session.client().link().round_trip_us());
            let at_us = now_us.saturating_sub(round_trip_us / 2);
            self.latency.record_measured(at_us, tool_force);
        }
        if self.state == State::Run {
            self.latency.record_sent(tool_force);
            self.master.send_force(tool_force);
        } else {
            self.master.send_force([0; COMPONENTS]);
        }
        let master_force = self.master.force().unwrap_or_default();
        let newtons = high.map(|part| f64::from(part) / 65_536.0);
        let keep_largest = |largest: &mut [f64; COMPONENTS], now: &[f64; COMPONENTS]| {
            for (largest, now) in largest.iter_mut().zip(now) {
                *largest = largest.max(now.abs());
            }
        };
        keep_largest(&mut self.outcome.largest_force_n, &newtons);
        keep_largest(&mut self.outcome.largest_feedback_n, &master_force.force);
        let three = |values: &[f64]| {
            std::array::from_fn(|axis| values.get(axis).copied().unwrap_or_default())
        };
        let model = self.session.model();
        let mm = |raw: i32| f64::from(raw) / haptimill_machine_file::scale::PER_MM;
        Some(Row {
            time_s: self.time_s(),
            state: telemetry.state,
            master: self.sample.pose.tip.map(mm),
            axes: self
                .sample
                .pose
                .axes
                .map(|axis| axis.map(|part| f64::from(part) / f64::from(i16::MAX))),
            enabling_switch: self.sample.pose.enabling_switch,
            age_ms: self
                .sampled_us
                .map_or(0.0, |at| now_us.saturating_sub(at) as f64 / 1000.0),
            commanded: three(&model.to_engineering_units(&telemetry.commanded)),
            tool: three(&model.to_engineering_units(&telemetry.measured)),
            tool_force: newtons,
            master_force,
        })
    }

    /// Takes a fault that is latched at the end, also if its event was not received.
    pub(super) fn evaluate_machine(&mut self, status: &Telemetry) {
        match (status.state, &status.fault) {
            (State::EmergencyStop, _) => {
                self.outcome.faults.push(EMERGENCY_STOP.to_string());
                self.outcome.because = Some(EMERGENCY_STOP.to_string());
            }
            (State::Fault, Some(fault)) if self.outcome.faults.is_empty() => {
                let fault = self.session.describe(fault);
                self.outcome.faults.push(fault);
            }
            (State::Fault, _) => {}
            _ => return,
        }
        self.outcome.ended = Ended::Fault;
    }
}
