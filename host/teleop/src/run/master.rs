//! The master: whether its samples arrive, in time, and whether it was ready to the end.

use super::{Report, Teleop};
use crate::MasterStatus;
use crate::outcome::Ended;
use haptimill_client::session::JobLine;
use haptimill_protocol::message::State;

/// Samples that were too old to move the tool.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct StaleSamples {
    count: u64,
    oldest_ms: u64,
    /// They were reported, with the enabling switch pressed.
    is_reported: bool,
}

impl StaleSamples {
    const REMEDY: &str = "give a larger --stale, or check the link";
}

impl<L: JobLine> Teleop<'_, L> {
    /// Sends the newest sample to the machine.
    pub(super) fn send_sample(&mut self) {
        if self.state != State::Run || self.is_over {
            return;
        }
        let mut pose = self.sample.pose;
        pose.enabling_switch &= !self.is_ending;
        let age_ms = self.sample.age_us / 1000;
        let is_stale = age_ms >= u64::from(self.options.stale_ms);
        let client = self.session.client_mut();
        let is_sent = match u8::try_from(age_ms) {
            Ok(age_ms) => client.send_master_pose(pose, age_ms).is_ok(),
            // The age does not fit into the message: a smaller one would make the sample valid.
            Err(_) if is_stale => true,
            Err(_) => client.send_master_pose(pose, u8::MAX).is_ok(),
        };
        self.outcome.samples_sent += u64::from(is_sent);
        if is_sent && is_stale {
            self.stale.count += 1;
            self.stale.oldest_ms = self.stale.oldest_ms.max(age_ms);
        }
    }

    /// Reports stale samples, and a link to the master that is lost or back.
    pub(super) fn report_master(&mut self, report: &mut Report<'_>) {
        if self.stale.count > 0 && self.sample.pose.enabling_switch && !self.stale.is_reported {
            self.stale.is_reported = true;
            let what = format!(
                "the samples of the master are {} ms old, and the machine rejects samples of {} ms and more; {}",
                self.stale.oldest_ms,
                self.options.stale_ms,
                StaleSamples::REMEDY
            );
            report(None, Some(&what));
        }
        // The controller of an arm reports its own faults.
        let waiting = match self.master.status() {
            MasterStatus::Waiting(reason) => Some(reason),
            MasterStatus::Ready | MasterStatus::Disabled(_) => None,
        };
        if waiting.is_some() != self.is_away {
            self.is_away = waiting.is_some();
            let reason = waiting
                .as_deref()
                .unwrap_or("its samples are received again");
            let what = format!("master: {reason}");
            if self.outcome.notes.contains(&what) {
                report(None, Some(&what));
            } else {
                self.note(what, report);
            }
        }
    }

    /// Adds stale samples and the final status of the master to the outcome.
    pub(super) fn evaluate_master(&mut self) {
        let StaleSamples {
            count, oldest_ms, ..
        } = self.stale;
        if count > 0 {
            let effect = if count == self.outcome.samples_sent {
                "; the tool was not moved"
            } else {
                ""
            };
            self.outcome.notes.push(format!(
                "{count} of {} samples of the master were too late, up to {oldest_ms} ms old; \
                 the limit is {} ms{effect}; {}",
                self.outcome.samples_sent,
                self.options.stale_ms,
                StaleSamples::REMEDY
            ));
        }
        if self.outcome.ended != Ended::Done {
            return;
        }
        let (ended, why) = match (self.master.status(), &self.unresumed) {
            (MasterStatus::Disabled(reason), _) => (
                Ended::HapticFault,
                format!(
                    "the master is disabled: {reason}; remove the cause, then command `reset-master`"
                ),
            ),
            (MasterStatus::Waiting(reason), _) => (
                Ended::MasterLost,
                format!("the master is lost: {reason}; check the arm and its link"),
            ),
            (MasterStatus::Ready, Some(reason)) if !self.is_ended_by_command => (
                Ended::MasterLost,
                format!(
                    "the machine held and was not resumed: {reason}; \
                     check the link, and command `resume` when the master is ready"
                ),
            ),
            (MasterStatus::Ready, _) => return,
        };
        self.outcome.ended = ended;
        self.outcome.because = Some(why);
    }
}
