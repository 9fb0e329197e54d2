//! Lines of a sender: blocks, jogs, and commands with `$`.

use super::{Activity, Bridge, Feed, SenderLine};
use crate::commands::bridge::report::{self, error};
use crate::commands::{CliError, Exit};
use haptimill_client::session::Homing;
use haptimill_gcode::{Problem, Step};
use haptimill_machine_file::model::{Model, settings};
use haptimill_planner::{Planner, Settings};
use haptimill_protocol::message::{Command, State};

/// How a line was handled.
enum Answer {
    Ok,
    Error(u8),
    /// It is handled when the machine has ended what it does.
    Later,
}

impl Bridge {
    /// Handles the next line; false when there is none, or it must wait.
    pub(super) fn handle_line(&mut self) -> Result<bool, CliError> {
        let text = match self.input.next() {
            None => return Ok(false),
            Some(SenderLine::Text(text)) => text.clone(),
            Some(SenderLine::Bad(what)) => {
                self.message(what);
                self.input.take();
                self.say(&format!("error:{}", error::OVERFLOW));
                return Ok(true);
            }
        };
        if matches!(self.activity, Activity::Homing(_) | Activity::GoingHome(_)) {
            return Ok(false);
        }
        let answer = match text.strip_prefix('$') {
            Some(command) => self.system(command)?,
            None if text.is_empty() => Answer::Ok,
            None => self.block(&text)?,
        };
        match answer {
            Answer::Later => return Ok(false),
            // Homing answers at its end.
            Answer::Ok if matches!(self.activity, Activity::Homing(_)) => {}
            Answer::Ok => self.say("ok"),
            Answer::Error(number) => self.say(&format!("error:{number}")),
        }
        self.input.take();
        Ok(true)
    }

    /// Ends a job that stands still; the answer to a command that needs an idle machine.
    fn idle(&mut self) -> Option<Answer> {
        let is_standing = self.is_standing();
        let has_stopped = self.speed == 0.0;
        match &mut self.activity {
            Activity::Nothing => None,
            Activity::Job { feed, .. } if feed.is_drained() && is_standing => {
                // All is planned: nothing can be refused.
                let _ = feed.end();
                Some(Answer::Later)
            }
            // The last setpoints of a job that was ended above.
            Activity::Job { feed, .. } if feed.has_ended() && has_stopped => Some(Answer::Later),
            _ => Some(Answer::Error(error::NOT_IDLE)),
        }
    }

    /// A command with `$`, without it.
    fn system(&mut self, command: &str) -> Result<Answer, CliError> {
        let upper = command.to_ascii_uppercase();
        let lines: Vec<String> = match upper.as_str() {
            "" => vec![report::HELP.to_string()],
            "$" => report::settings(&self.machine),
            "#" => report::offsets(&self.dialog),
            "G" => vec![report::modes(&self.dialog, self.coolant)],
            "I" => report::BUILD.map(String::from).to_vec(),
            "N" => vec!["$N0=".to_string(), "$N1=".to_string()],
            "H" | "X" | "C" => {
                if let Some(answer) = self.idle() {
                    return Ok(answer);
                }
                return Ok(match upper.as_str() {
                    "H" => self.begin_homing(),
                    "X" => self.unlock(),
                    _ => self.toggle_check(),
                });
            }
            _ if upper.starts_with("J=") => return self.jog(&command[2..]),
            _ if upper.contains('=') || upper.starts_with("RST") => {
                self.message("settings are those of the machine file; edit it and start again");
                return Ok(Answer::Error(error::SETTING));
            }
            _ => return Ok(Answer::Error(error::STATEMENT)),
        };
        for line in lines {
            self.say(&line);
        }
        Ok(Answer::Ok)
    }

    /// Enables the drives; the number of the error otherwise.
    fn enable(&mut self) -> Option<Answer> {
        let problem = self.session.enable().err()?;
        self.message(&problem.message);
        Some(Answer::Error(error::LOCKED))
    }

    fn begin_homing(&mut self) -> Answer {
        if let Some(answer) = self.enable() {
            return answer;
        }
        self.activity = Activity::Homing(Homing::start(&mut self.session));
        Answer::Ok
    }

    fn unlock(&mut self) -> Answer {
        if matches!(self.state(), State::Fault | State::EmergencyStop)
            && let Err(problem) = self.session.ask(Command::Reset)
        {
            self.message(&problem.message);
            return Answer::Error(error::LOCKED);
        }
        if let Some(answer) = self.enable() {
            return answer;
        }
        self.report_always();
        if self.session.status().is_ok_and(|now| now.homed) {
            self.message("Caution: Unlocked");
            return Answer::Ok;
        }
        self.message("the position is unknown; home the machine with $H");
        Answer::Error(error::LOCKED)
    }

    fn toggle_check(&mut self) -> Answer {
        self.is_checking = !self.is_checking;
        self.message(if self.is_checking {
            "Enabled"
        } else {
            "Disabled"
        });
        // What was checked leaves nothing in force, as after a reset.
        self.is_resetting = !self.is_checking;
        Answer::Ok
    }

    /// Begins a job at the present pose, if none runs.
    fn begin_job(&mut self, jogs: bool) -> Result<Option<Answer>, CliError> {
        match &mut self.activity {
            Activity::Job { is_jog, .. } if self.is_dropping || *is_jog != jogs => {
                if self.is_dropping {
                    return Ok(Some(Answer::Later));
                }
                return Ok(self.idle().map(|answer| match answer {
                    Answer::Error(_) if !jogs => Answer::Error(error::LOCKED),
                    answer => answer,
                }));
            }
            Activity::Job { feed, .. } => {
                return Ok((feed.has_ended() || !feed.has_room()).then_some(Answer::Later));
            }
            _ => {}
        }
        if !self.is_ready() {
            self.message("home the machine with $H");
            return Ok(Some(Answer::Error(error::LOCKED)));
        }
        if let Some(answer) = self.enable() {
            return Ok(Some(answer));
        }
        let start = self.session.status()?.commanded;
        let here = self.session.model().to_engineering_units(&start);
        self.dialog.place_at(&here);
        let model = Model::new(&self.machine);
        let settings = Settings {
            spindle_percent: self.overrides[2],
            ..settings(&self.machine)
        };
        let planner = Planner::new(here, settings, model);
        self.activity = Activity::Job {
            feed: Box::new(Feed::new(planner, self.dialog.line())),
            run: None,
            start,
            is_jog: jogs,
        };
        Ok(None)
    }

    /// Adds steps to the job.
    fn add(&mut self, steps: &[Step]) -> Result<(), Problem> {
        for step in steps {
            match step {
                Step::Spindle { rpm, .. } => self.spindle_rpm = *rpm,
                Step::Coolant { mist, flood, .. } => self.coolant = (*mist, *flood),
                _ => {}
            }
        }
        let line = self.dialog.line();
        match &mut self.activity {
            Activity::Job { feed, .. } => feed.add(steps, line),
            _ => Ok(()),
        }
    }

    fn refuse(&mut self, problem: &Problem) {
        self.message(&format!("{}; {}", problem.what, problem.remedy));
    }

    /// The steps of a line, and messages in it.
    fn steps(&mut self, text: &str) -> Result<Vec<Step>, Problem> {
        self.dialog.enter(text);
        let mut steps = Vec::new();
        while let Some(step) = self.dialog.next_step()? {
            match step {
                Step::Message { text, .. } => self.message(&text),
                Step::Probe { .. } | Step::Wait { .. } => {
                    self.dialog.undo();
                    return Err(Problem {
                        place: step.place(),
                        what: "probe moves and M66 are not possible from a sender".into(),
                        remedy: "use `haptimill probe` or `haptimill mdi`".into(),
                    });
                }
                Step::ToolChange { tool, .. } => {
                    self.message(&format!("fit tool {tool}"));
                    steps.push(step);
                }
                _ => steps.push(step),
            }
        }
        Ok(steps)
    }

    /// A block of a program.
    fn block(&mut self, text: &str) -> Result<Answer, CliError> {
        if self.is_checking {
            return Ok(self.check_block(text));
        }
        if let Some(answer) = self.begin_job(false)? {
            return Ok(answer);
        }
        let steps = match self.steps(text) {
            Ok(steps) => steps,
            Err(problem) => {
                let has_no_feed = problem.what.contains("feed") && problem.remedy.contains('F');
                self.refuse(&problem);
                let number = if has_no_feed {
                    error::FEED
                } else {
                    error::BLOCK
                };
                return Ok(Answer::Error(number));
            }
        };
        let notices: Vec<String> = self
            .dialog
            .notices()
            .iter()
            .map(|notice| notice.what.clone())
            .collect();
        for notice in notices {
            self.message(&notice);
        }
        self.keep_changes()?;
        if let Err(problem) = self.add(&steps) {
            self.refuse(&problem);
            if let Activity::Job { feed, .. } = &mut self.activity {
                let _ = feed.end();
            }
            return Ok(Answer::Error(error::BLOCK));
        }
        Ok(Answer::Ok)
    }

    /// Checks a block against the language; the limits are checked when it moves the machine.
    fn check_block(&mut self, text: &str) -> Answer {
        match self.steps(text) {
            Ok(_) => Answer::Ok,
            Err(problem) => {
                self.refuse(&problem);
                Answer::Error(error::BLOCK)
            }
        }
    }

    /// A jog: a straight move that a jog cancel ends. It leaves nothing in force.
    fn jog(&mut self, words: &str) -> Result<Answer, CliError> {
        let plain: String = words
            .chars()
            .filter(|letter| !letter.is_whitespace())
            .collect();
        let plain = plain.to_ascii_uppercase();
        if let Err(answer) = check_jog(&plain) {
            return Ok(answer);
        }
        if let Some(answer) = self.begin_job(true)? {
            return Ok(answer);
        }
        let steps = match self.steps(&format!("G94 G1 {plain}")) {
            Ok(steps) => steps,
            Err(problem) => {
                self.refuse(&problem);
                return Ok(Answer::Error(error::BAD_JOG));
            }
        };
        let end = steps.iter().rev().find_map(|step| match step {
            Step::Move(step) => Some(step.tool.machine_pose(&step.path.to)),
            _ => None,
        });
        self.dialog.undo();
        if let Err(problem) = self.add(&steps) {
            self.refuse(&problem);
            if let Activity::Job { feed, .. } = &mut self.activity {
                let _ = feed.end();
            }
            return Ok(Answer::Error(error::TRAVEL));
        }
        if let Some(end) = end {
            self.dialog.place_at(&end);
        }
        Ok(Answer::Ok)
    }

    /// Writes offsets and tools that a block changed.
    fn keep_changes(&mut self) -> Result<(), CliError> {
        let kept = self.data.keep(
            self.dialog.offsets(),
            self.dialog.tools(),
            self.file.as_deref(),
        );
        kept.map_err(|error| CliError::new(Exit::Output, error))?;
        Ok(())
    }
}

/// Checks the words of a jog, in upper case and without blanks.
fn check_jog(words: &str) -> Result<(), Answer> {
    let letters: Vec<char> = words.chars().filter(char::is_ascii_alphabetic).collect();
    if !letters.contains(&'F') {
        return Err(Answer::Error(error::FEED));
    }
    let is_known = |letter: &char| "GFXYZABCN".contains(*letter);
    if !letters.iter().all(is_known) || !letters.iter().any(|letter| "XYZABC".contains(*letter)) {
        return Err(Answer::Error(error::BAD_JOG));
    }
    let codes = words.split('G').skip(1).map(|rest| {
        let end = rest.find(|letter: char| !letter.is_ascii_digit() && letter != '.');
        &rest[..end.unwrap_or(rest.len())]
    });
    for code in codes {
        if !["20", "21", "53", "90", "91"].contains(&code) {
            return Err(Answer::Error(error::BAD_JOG));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jog_has_a_feed_an_axis_and_no_other_modes() {
        for good in ["G91G21X10F500", "X1F100", "G53G90Z-1.5F20"] {
            assert!(check_jog(good).is_ok(), "{good}");
        }
        for (bad, number) in [
            ("X10", error::FEED),
            ("G91F100", error::BAD_JOG),
            ("G2X1F100", error::BAD_JOG),
            ("X1F100M3", error::BAD_JOG),
            ("G90.1X1F100", error::BAD_JOG),
        ] {
            let answer = check_jog(bad);
            assert!(
                matches!(answer, Err(Answer::Error(it)) if it == number),
                "{bad}"
            );
        }
    }
}
