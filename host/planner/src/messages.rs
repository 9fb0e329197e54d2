//! Messages of a program on their way to the operator.

use haptimill_gcode::Place;
use std::collections::VecDeque;

/// Messages whose motion is not made yet. A motion has the number of messages before it.
#[derive(Debug, Default)]
pub(crate) struct Messages {
    waiting: VecDeque<Message>,
    count: u32,
}

#[derive(Debug)]
struct Message {
    /// Number of messages before it.
    before: u32,
    place: Place,
    text: String,
}

impl Messages {
    /// Adds the next message.
    pub(crate) fn add(&mut self, place: Place, text: &str) {
        self.waiting.push_back(Message {
            before: self.count,
            place,
            text: text.to_string(),
        });
        self.count = self.count.saturating_add(1);
    }

    /// Number of messages so far.
    pub(crate) const fn count(&self) -> u32 {
        self.count
    }

    /// Removes the messages in the block of a pause: the pause shows its comment itself.
    pub(crate) fn drop_block(&mut self, pause: Place) {
        let is_of_pause = |message: &mut Message| {
            (message.place.file, message.place.line) == (pause.file, pause.line)
        };
        while self.waiting.pop_back_if(is_of_pause).is_some() {}
    }

    /// Removes the messages before a motion.
    pub(crate) fn take_before(&mut self, motion: u32, mut take: impl FnMut(String)) {
        let is_due = |message: &mut Message| message.before < motion;
        while let Some(message) = self.waiting.pop_front_if(is_due) {
            take(message.text);
        }
    }
}
