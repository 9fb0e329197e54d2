//! The hand: whether its words come, in time, and whether it could lead to the end.

use super::Teleop;
use crate::Standing;
use crate::outcome::{Ended, Row};
use haptimill_client::session::JobLine;
use haptimill_protocol::message::State;

/// Words of a hand that came too late to lead.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Late {
    words: u64,
    oldest_ms: u64,
    /// The button was held, and it was told.
    told: bool,
}

impl<L: JobLine> Teleop<'_, L> {
    /// The newest word goes to the machine.
    pub(super) fn tell(&mut self) {
        if self.state != State::Run || self.over {
            return;
        }
        let mut hand = self.word.hand;
        hand.engaged &= !self.ending;
        let age_ms = self.word.age_us / 1000;
        let late = age_ms >= u64::from(self.options.stale_ms);
        let said = match u8::try_from(age_ms) {
            Ok(age_ms) => self.session.client_mut().lead(hand, age_ms).is_ok(),
            // Older than can be said: it would lead as a younger one.
            Err(_) if late => true,
            Err(_) => self.session.client_mut().lead(hand, u8::MAX).is_ok(),
        };
        self.outcome.words += u64::from(said);
        if said && late {
            self.late.words += 1;
            self.late.oldest_ms = self.late.oldest_ms.max(age_ms);
        }
    }

    /// What becomes of the hand is told, also while it leads nothing.
    pub(super) fn hear_hand(&mut self, look: &mut dyn FnMut(Option<&Row>, Option<&str>)) {
        if self.late.words > 0 && self.word.hand.engaged && !self.late.told {
            self.late.told = true;
            let what = format!(
                "the words of the hand are {} ms old, and the machine follows none of {} ms and more; {}",
                self.late.oldest_ms,
                self.options.stale_ms,
                Late::REMEDY
            );
            look(None, Some(&what));
        }
        let standing = self.source.standing();
        // What is wrong with the arm itself is told by its controller.
        let away = match standing {
            Standing::Waiting(why) => Some(why),
            Standing::Ready | Standing::Off(_) => None,
        };
        if away.is_some() != self.away {
            self.away = away.is_some();
            let why = away.as_deref().unwrap_or("it is heard again");
            let what = format!("the hand: {why}");
            if self.outcome.notes.contains(&what) {
                look(None, Some(&what));
            } else {
                self.note(what, look);
            }
        }
    }

    /// The last word about the hand.
    pub(super) fn judge_hand(&mut self) {
        let Late {
            words, oldest_ms, ..
        } = self.late;
        if words > 0 {
            let led = if words == self.outcome.words {
                "; the tool was not led"
            } else {
                ""
            };
            self.outcome.notes.push(format!(
                "{words} of {} words of the hand were too late, up to {oldest_ms} ms old where {} ms are too old{led}; {}",
                self.outcome.words, self.options.stale_ms, Late::REMEDY
            ));
        }
        if self.outcome.ended != Ended::Done {
            return;
        }
        let (ended, why) = match (self.source.standing(), &self.unresumed) {
            (Standing::Off(why), _) => (
                Ended::HapticFault,
                format!("the hand leads no more: {why}; remove the cause, then order `reset-hand`"),
            ),
            (Standing::Waiting(why), _) => (
                Ended::MasterLost,
                format!("the hand is lost: {why}; look after the arm and its link"),
            ),
            (Standing::Ready, Some(why)) if !self.ended_by_order => (
                Ended::MasterLost,
                format!(
                    "the machine held and was not told to go on: {why}; look after the link, and order `resume` when the hand is there"
                ),
            ),
            (Standing::Ready, _) => return,
        };
        self.outcome.ended = ended;
        self.outcome.because = Some(why);
    }
}

impl Late {
    /// What helps.
    const REMEDY: &str = "give a larger --stale, or look after the link";
}
