//! Codes: the G and M words, and their modal groups.

use super::expression::Read;
use super::problem::Mistake;

/// Modal groups of G words and groups of M words; a block has at most one word of each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Group {
    /// G4, G10, G28, G30, G92: this block only.
    Once,
    Motion,
    Plane,
    Distance,
    CentreDistance,
    FeedMode,
    Unit,
    Compensation,
    ToolLength,
    Return,
    System,
    PathControl,
    SpindleMode,
    /// G53.
    Machine,
    Stop,
    Spindle,
    ToolChange,
    /// M7 and M8, which may be together.
    Mist,
    Flood,
    Override,
    Output,
    State,
    Subprogram,
}

/// Number of groups.
pub(crate) const GROUPS: usize = Group::Subprogram as usize + 1;

impl Group {
    fn name(self) -> &'static str {
        match self {
            Group::Once => "non-modal codes",
            Group::Motion => "motion",
            Group::Plane => "plane",
            Group::Distance => "distance",
            Group::CentreDistance => "distance of arc centres",
            Group::FeedMode => "feed mode",
            Group::Unit => "unit",
            Group::Compensation => "cutter compensation",
            Group::ToolLength => "tool length",
            Group::Return => "return level of cycles",
            Group::System => "coordinate system",
            Group::PathControl => "path control",
            Group::SpindleMode => "spindle mode",
            Group::Machine => "machine coordinates",
            Group::Stop => "stop",
            Group::Spindle => "spindle",
            Group::ToolChange => "tool change",
            Group::Mist | Group::Flood => "coolant",
            Group::Override => "override",
            Group::Output => "inputs and outputs",
            Group::State => "modal state",
            Group::Subprogram => "subprogram",
        }
    }
}

/// A code: its number in tenths, and its place in the line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Code {
    /// Number in tenths: 381 is G38.1.
    pub tenths: u16,
    /// Place of the letter.
    pub at: usize,
    /// End of the word.
    pub end: usize,
}

/// Codes of a block by group.
#[derive(Debug, Default, Clone)]
pub(crate) struct Codes {
    slots: [Option<Code>; GROUPS],
}

impl Codes {
    /// Returns the code of a group.
    pub(crate) fn get(&self, group: Group) -> Option<Code> {
        self.slots[group as usize]
    }

    /// Returns the number of the code of a group, in tenths.
    pub(crate) fn tenths(&self, group: Group) -> Option<u16> {
        self.get(group).map(|code| code.tenths)
    }

    /// Enters a code.
    pub(crate) fn enter(&mut self, group: Group, code: Code, line: &[u8]) -> Read<()> {
        let slot = &mut self.slots[group as usize];
        if group == Group::Motion && slot.is_some_and(|first| first.tenths != code.tenths) {
            // G80 ends a cycle, as any motion word does: CAM systems write both in one block.
            if code.tenths == 800 {
                return Ok(());
            }
            if slot.is_some_and(|first| first.tenths == 800) {
                *slot = None;
            }
        }
        if let Some(first) = slot {
            let what = format!(
                "{} and {} in one block: both are of modal group {}",
                word(line, code),
                word(line, *first),
                group.name()
            );
            return Err(Box::new(Mistake::new(code.at, what, "keep one")));
        }
        *slot = Some(code);
        Ok(())
    }
}

/// Returns the text of a code.
pub(crate) fn word(line: &[u8], code: Code) -> String {
    super::expression::text_of(&line[code.at..code.end])
}

/// Returns the tenths of a code's value.
pub(crate) fn tenths(value: f64) -> Option<u16> {
    let tenths = value * 10.0;
    let rounded = tenths.round();
    ((rounded - tenths).abs() < 1e-3 && (0.0..=9990.0).contains(&rounded)).then_some(rounded as u16)
}

/// Returns the group of a G code.
pub(crate) fn g_group(tenths: u16) -> Option<Group> {
    Some(match tenths {
        0
        | 10
        | 20
        | 30
        | 50
        | 51
        | 52
        | 53
        | 382..=385
        | 730
        | 740
        | 800
        | 810
        | 820
        | 830
        | 840
        | 850
        | 860
        | 870
        | 880
        | 890 => Group::Motion,
        40 | 100 | 280 | 281 | 300 | 301 | 520 | 920..=923 => Group::Once,
        530 => Group::Machine,
        170 | 180 | 190 => Group::Plane,
        200 | 210 | 700 | 710 => Group::Unit,
        400 | 410 | 411 | 420 | 421 => Group::Compensation,
        430 | 431 | 432 | 490 => Group::ToolLength,
        540 | 550 | 560 | 570 | 580 | 590..=593 => Group::System,
        610 | 611 | 640 => Group::PathControl,
        900 | 910 => Group::Distance,
        901 | 911 => Group::CentreDistance,
        930 | 940 | 950 => Group::FeedMode,
        960 | 970 => Group::SpindleMode,
        980 | 990 => Group::Return,
        _ => return None,
    })
}

/// Returns the group of an M code.
pub(crate) fn m_group(number: u16) -> Option<Group> {
    Some(match number {
        0 | 1 | 2 | 30 | 60 => Group::Stop,
        3 | 4 | 5 | 13 | 14 | 19 => Group::Spindle,
        6 | 61 => Group::ToolChange,
        7 => Group::Mist,
        8 | 9 => Group::Flood,
        48..=53 => Group::Override,
        62..=68 => Group::Output,
        70..=73 => Group::State,
        98 | 99 => Group::Subprogram,
        _ => return None,
    })
}

/// Returns the remedy for a G code that is not supported.
pub(crate) fn g_remedy(tenths: u16) -> &'static str {
    match tenths {
        70 | 80 => "diameter and radius modes belong to lathes: remove it",
        330 | 331 | 760 => {
            "threading follows the spindle's encoder, which this machine does not have: \
             write a program for a mill"
        }
        711 | 712 | 720..=722 => {
            "turning cycles belong to lathes: write the passes as G0 and G1, or a program for a mill"
        }
        171 | 181 | 191 => "planes of U, V, W are not supported: write G17, G18 or G19",
        90 => "write G61, which stops exactly until G64",
        120 | 130 => "write the circle of the pocket as G2 or G3",
        150 | 160 => "write polar coordinates as @ (distance) and ^ (angle)",
        310 => "write G38.2, which stops at the contact of the probe",
        500 | 510 => "scaling and mirroring are not supported: let the CAM system write the moves",
        541 => "write G59.1 to G59.3: there are nine coordinate systems",
        650..=670 => "macros are called as O<name> call, or as M98 P",
        680 | 690 => "write G10 L2 P R, which turns a coordinate system",
        _ => "remove it if the part does not need it",
    }
}

/// Returns the remedy for an M code that is not supported.
pub(crate) fn m_remedy(number: u16) -> &'static str {
    match number {
        100..=199 => "it is a code of one manufacturer: remove it if the part does not need it",
        _ => "remove it if the part does not need it",
    }
}

#[cfg(test)]
mod tests {
    use super::{g_group, m_group};
    use std::collections::BTreeSet;

    const PAGE: &str = include_str!("../../../docs/gcode.md");

    /// The codes of a letter in the first column of the tables of a text, in tenths; a range is
    /// written `G54 to G59`.
    fn codes(text: &str, letter: char) -> BTreeSet<u16> {
        let mut codes = BTreeSet::new();
        for row in text.lines().filter_map(|line| line.strip_prefix("| ")) {
            let first = row.split(" |").next().unwrap_or_default();
            let mut from = None;
            let mut is_range = false;
            for word in first.split([' ', ',']).filter(|word| !word.is_empty()) {
                let number = word.strip_prefix(letter);
                let number = number.and_then(|number| number.parse::<f64>().ok());
                let Some(code) = number.map(|number| (number * 10.0).round() as u16) else {
                    is_range = word == "to";
                    continue;
                };
                // A range of whole codes has no codes with a tenth.
                let step = if code % 10 == 0 { 10 } else { 1 };
                match from {
                    Some(from) if is_range => codes.extend((from..=code).step_by(step)),
                    _ => codes.extend([code]),
                }
                (from, is_range) = (Some(code), false);
            }
        }
        codes
    }

    #[test]
    fn the_page_lists_each_code() {
        let (supported, refused) = PAGE.split_once("\n## Refused\n").expect("two parts");
        let g: BTreeSet<u16> = (0..=9990).filter(|code| g_group(*code).is_some()).collect();
        assert_eq!(codes(supported, 'G'), g);
        let m: BTreeSet<u16> = (0..=999).filter(|code| m_group(*code).is_some()).collect();
        let listed = codes(supported, 'M');
        assert_eq!(listed, m.iter().map(|code| code * 10).collect());
        // Of these G70 and G71 are units without Q.
        let refused = refused.split("\n## ").next().unwrap_or_default();
        let refused = codes(refused, 'G');
        assert!(refused.len() > 10, "{refused:?}");
        let both: Vec<_> = refused.intersection(&g).collect();
        assert_eq!(both, [&700, &710]);
    }
}
