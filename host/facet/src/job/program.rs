//! The whole job as one part program: what the cutter reads in its comments, and its pauses.

use super::{Coolant, FORCE_FEED, Job, Mode, Mount};
use crate::design::{Side, Tier};
use crate::gem::Gem;
use crate::problem::one_line;
use core::fmt::Write as _;

/// Longest line of a comment. Senders of part programs take lines of up to 256 bytes.
const COMMENT: usize = 100;

/// Text for a comment of a part program: of one line, without parentheses.
pub(super) fn plain(text: &str) -> String {
    one_line(text).replace(['(', ')'], " ")
}

/// Writes a text as comments of at most [`COMMENT`] letters.
fn comment(program: &mut String, text: &str) {
    let text = plain(text);
    let mut line = String::new();
    let mut end = |line: &mut String| {
        if !line.is_empty() {
            let _ = writeln!(program, "({line})");
            line.clear();
        }
    };
    for word in text.split_whitespace() {
        if line.chars().count() + 1 + word.chars().count() > COMMENT {
            end(&mut line);
        }
        if !line.is_empty() {
            line.push(' ');
        }
        // A word that is longer than a line is continued in the next one.
        for letter in word.chars() {
            if line.chars().count() == COMMENT {
                end(&mut line);
            }
            line.push(letter);
        }
    }
    end(&mut line);
}

impl Job {
    /// Maximum feed into the stone where its force is not held, mm/s.
    #[must_use]
    pub fn max_feed_mm_s(&self) -> f64 {
        match self.settings.mode {
            Mode::Force => FORCE_FEED,
            Mode::Feed | Mode::Both => {
                let laps = self.passes.iter().map(|pass| pass.lap);
                let feeds = laps.map(|lap| self.settings.laps[lap].feed_mm_s);
                feeds.fold(0.0, f64::max)
            }
        }
    }

    /// The whole job as one part program. Its comments have the design, how the stone is mounted,
    /// and the tiers with their notes. For each lap, and for the transfer, spindle and coolant stop
    /// and the program pauses. By force it is for a controller that holds the force: the first
    /// pause says so, and a comment has the force of each facet.
    #[must_use]
    pub fn program(&self, gem: &Gem, coolant: Coolant) -> String {
        let has_force = self.settings.mode.has_force();
        let mut text = String::new();
        self.header(gem, &mut text);
        let tiers = gem.design.tiers();
        let mut side = None;
        for pass in &self.passes {
            let mut tasks = Vec::new();
            if side.is_none() && has_force {
                tasks.push("ground by force: put the height under force control".to_string());
            }
            if side.is_some() {
                text.push_str("M5\n");
                if coolant != Coolant::None {
                    text.push_str("M9\n");
                }
            }
            if side.is_some_and(|side| side != pass.mount.side) {
                let [from, to] = [0.0, 180.0].map(|azimuth| gem.design.index_at(azimuth));
                comment(&mut text, &over(gem, &pass.mount));
                tasks.push(format!(
                    "transfer: turn the stone over on a new dop about the axis through index \
                     {from} and {to}"
                ));
            }
            side = Some(pass.mount.side);
            let lap = plain(&self.settings.laps[pass.lap].name);
            tasks.push(format!("put on lap {lap}"));
            let _ = writeln!(text, "M0 (MSG, {})", tasks.join("; "));
            let mut before = None;
            for (number, operation) in pass.operations.iter().enumerate() {
                let tier = tiers
                    .iter()
                    .find(|tier| tier.facets.contains(&operation.facet));
                if let Some(tier) = tier.filter(|tier| before != Some(tier.facets[0])) {
                    before = Some(tier.facets[0]);
                    describe(gem, tier, &mut text);
                }
                if has_force {
                    let _ = writeln!(text, "(force {:.2} N)", operation.force_n);
                }
                for line in operation.grind.lines().chain(operation.retract.lines()) {
                    let _ = writeln!(text, "{line}");
                    let starts = line.ends_with(" M3") || line.ends_with(" M4");
                    match coolant {
                        Coolant::Flood if starts && number == 0 => text.push_str("M8\n"),
                        Coolant::Mist if starts && number == 0 => text.push_str("M7\n"),
                        _ => {}
                    }
                }
            }
        }
        text.push_str("M5\n");
        if coolant != Coolant::None {
            text.push_str("M9\n");
        }
        text.push_str("M30\n");
        text
    }

    /// Comments on the design, the rough and the force.
    fn header(&self, gem: &Gem, text: &mut String) {
        let design = &gem.design;
        // A design may have no title; the name of its file tells what the program cuts.
        let title = match design.title.trim() {
            "" => &gem.file,
            title => title,
        };
        comment(text, &format!("design {title}"));
        for remark in &design.remarks {
            comment(text, &format!("remark: {remark}"));
        }
        let what = format!(
            "{}; refractive index {}; symmetry {}",
            design.wheel_text(),
            design.refractive_index,
            design.symmetry.text()
        );
        comment(text, &what);
        if let Some(pass) = self.passes.first() {
            comment(text, &rough(gem, &pass.mount));
        }
        if self.settings.mode.has_force() {
            let what = "ground by force: the depths are reached under force control of the height \
                        only";
            comment(text, what);
            let what = format!(
                "without it the stone is fed at up to {} mm/s whatever the force",
                self.max_feed_mm_s()
            );
            comment(text, &what);
        }
    }
}

/// The tier of the next facets, for the cutter.
fn describe(gem: &Gem, tier: &Tier, text: &mut String) {
    let what = format!(
        "tier {}, {}: angle {:.2} deg, index {} of {}",
        tier.name,
        tier.stage.name(),
        tier.angle_deg,
        tier.index_text(),
        gem.design.gear
    );
    comment(text, &what);
    if !tier.note.is_empty() {
        comment(text, &format!("note: {}", tier.note));
    }
}

/// Size of the rough, and where it is on the dop.
fn rough(gem: &Gem, mount: &Mount) -> String {
    let [_, _, [.., flip]] = mount.axes();
    let half = 0.5 * gem.rough.height_mm;
    let middle = flip * gem.rough_middle_mm;
    format!(
        "rough of {:.3} mm diameter and {:.3} mm height, centred on the axis of the dop; its ends \
         are {:.3} mm beyond the tip, on the side of the lap, and {:.3} mm behind it; the tip is \
         the origin of the design",
        gem.rough.diameter_mm,
        gem.rough.height_mm,
        middle + half,
        half - middle
    )
}

/// How the stone is turned over.
fn over(gem: &Gem, mount: &Mount) -> String {
    let [_, _, [.., flip]] = mount.axes();
    let behind = gem.body.reach([0.0, 0.0, -flip]);
    let (end, of) = match mount.side {
        Side::Crown => ("lower", "pavilion"),
        Side::Pavilion => ("upper", "crown"),
    };
    let index = gem.design.index_at(0.0);
    format!(
        "the new dop holds the {of}; index {index} stays where it was, at C180; the {end} end of \
         the stone is {behind:.3} mm behind the tip, which is again the origin of the design"
    )
}
