//! From the words of a line to a block: every word known, none twice, one of a modal group.

use super::lexer::{Line, Word};
use super::problem::{Place, Problems};
use super::{LONGEST_DWELL_S, Options};

/// G0 to G3, and none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Motion {
    Rapid,
    Straight,
    Clockwise,
    CounterClockwise,
    Off,
}

/// G17 to G19.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Plane {
    Xy,
    Zx,
    Yz,
}

/// M0, M1, M2 and M30.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stop {
    Pause,
    OptionalPause,
    End,
}

/// What the spindle does.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Turn {
    /// It stands (M5).
    #[default]
    Off,
    /// M3.
    Clockwise,
    /// M4.
    CounterClockwise,
}

/// The words of a block, sorted out.
#[derive(Debug, Default)]
pub(crate) struct Block {
    pub motion: Option<(Place, Motion)>,
    pub plane: Option<Plane>,
    pub inch: Option<bool>,
    pub incremental: Option<bool>,
    pub exact_stop: Option<bool>,
    pub dwell: Option<Place>,
    pub spindle: Option<(Place, Turn)>,
    pub stop: Option<(Place, Stop)>,
    pub feed: Option<Word>,
    pub speed: Option<Word>,
    pub seconds: Option<Word>,
    pub radius: Option<Word>,
    /// I, J, K.
    pub centre: [Option<Word>; 3],
    /// Words of the pose coordinates, in the machine's order.
    pub axes: [Option<Word>; 6],
    /// Something was refused: the block's motion is not trusted.
    pub broken: bool,
}

impl Block {
    /// The first of the axis words.
    pub(crate) fn first_axis(&self) -> Option<&Word> {
        self.axes.iter().flatten().min_by_key(|word| word.place)
    }
}

/// One word of each modal group in a block.
#[derive(Default)]
struct Groups {
    seen: Vec<(&'static str, String)>,
}

impl Groups {
    fn enter(&mut self, group: &'static str, word: &Word, problems: &mut Problems) -> bool {
        if let Some((_, first)) = self.seen.iter().find(|(seen, _)| *seen == group) {
            let what = format!("{} and {first} in one block: both say {group}", word.text);
            problems.add(word.place, what, "keep the one that is meant");
            return false;
        }
        self.seen.push((group, word.text.clone()));
        true
    }
}

/// Sorts out the words of a line. `first_block` allows an O word.
pub fn sort(line: &Line, options: &Options, first_block: bool, problems: &mut Problems) -> Block {
    let before = problems.count();
    let mut block = Block::default();
    let mut groups = Groups::default();
    let mut letters: Vec<char> = Vec::new();
    for (index, word) in line.words.iter().enumerate() {
        let letter = word.letter;
        if letter != 'G' && letter != 'M' {
            if letters.contains(&letter) {
                let what = format!("the letter {letter} stands twice in one block");
                problems.add(word.place, what, "keep the one that is meant");
                continue;
            }
            letters.push(letter);
        }
        let slot = match letter {
            'G' => {
                general(word, &mut block, &mut groups, problems);
                continue;
            }
            'M' => {
                miscellaneous(word, &mut block, &mut groups, problems);
                continue;
            }
            'N' => {
                if index > 0 {
                    problems.add(
                        word.place,
                        "a block number inside a block",
                        "write N at the start of the line",
                    );
                } else if word.value < 0.0 || word.value.fract() != 0.0 {
                    problems.add(
                        word.place,
                        format!("{} is not a block number", word.text),
                        "number blocks by whole numbers, or not",
                    );
                }
                continue;
            }
            'O' if first_block && line.words.len() == 1 => continue,
            'F' => &mut block.feed,
            'S' => &mut block.speed,
            'P' => &mut block.seconds,
            'R' => &mut block.radius,
            'I' => &mut block.centre[0],
            'J' => &mut block.centre[1],
            'K' => &mut block.centre[2],
            _ => match options
                .axes
                .iter()
                .take(6)
                .position(|axis| axis.letter == letter)
            {
                Some(axis) => &mut block.axes[axis],
                None => {
                    let (what, remedy) = unknown_letter(word);
                    problems.add(word.place, what, remedy);
                    continue;
                }
            },
        };
        *slot = Some(word.clone());
    }
    check_companions(&block, problems);
    block.broken = line.broken || problems.count() > before;
    block
}

fn unknown_letter(word: &Word) -> (String, &'static str) {
    let text = &word.text;
    match word.letter {
        'T' => (
            format!("tool change {text} is not possible: this machine has one tool"),
            "take out the T word, one program for each tool",
        ),
        'X' | 'Y' | 'Z' | 'A' | 'B' | 'C' | 'U' | 'V' | 'W' => (
            format!("{text}: this machine has no axis {}", word.letter),
            "write the program for the axes of the machine file",
        ),
        'D' | 'H' => (
            format!("{text}: tool offsets are not known"),
            "let the program that wrote this file put in the tool",
        ),
        'E' => (
            format!("{text}: exponents are not known"),
            "write the number out",
        ),
        'O' => (
            format!("program number {text} is not alone in the first block"),
            "take it out; subprograms are not known",
        ),
        _ => (
            format!("{text} is not known"),
            "take it out, or put it in a comment ( )",
        ),
    }
}

fn general(word: &Word, block: &mut Block, groups: &mut Groups, problems: &mut Problems) {
    // Tenths tell G61 from G61.1.
    let tenths = word.value * 10.0;
    let code = if tenths.fract() == 0.0 {
        tenths as i64
    } else {
        -1
    };
    let motion = match code {
        0 => Some(Motion::Rapid),
        10 => Some(Motion::Straight),
        20 => Some(Motion::Clockwise),
        30 => Some(Motion::CounterClockwise),
        800 => Some(Motion::Off),
        _ => None,
    };
    if let Some(motion) = motion {
        if groups.enter("how to move", word, problems) {
            block.motion = Some((word.place, motion));
        }
        return;
    }
    let group = match code {
        40 => "what to do once",
        170 | 180 | 190 => "the plane",
        200 | 210 | 700 | 710 => "the unit",
        400 => "cutter compensation",
        490 => "tool length",
        610 | 640 => "what to do at corners",
        900 | 910 => "absolute or incremental",
        940 => "the unit of feed",
        _ => {
            let remedy = match code {
                410 | 420 => {
                    "cutter compensation is not known: let the program that wrote this file do it"
                }
                430..=439 => "tool lengths are part of the machine file here: take it out",
                530..=599 => {
                    "there is one work coordinate system, that of the machine file: take it out"
                }
                280..=309 => "write the move as G0 with its coordinates",
                730 | 810..=899 => "drilling cycles are not known: write the moves out",
                930 | 950 => "write feeds per minute (G94)",
                901 => "centres are from the start of the arc (G91.1)",
                _ => "take it out if the part can do without it",
            };
            problems.add(word.place, format!("{} is not known", word.text), remedy);
            return;
        }
    };
    if !groups.enter(group, word, problems) {
        return;
    }
    match code {
        40 => block.dwell = Some(word.place),
        170 => block.plane = Some(Plane::Xy),
        180 => block.plane = Some(Plane::Zx),
        190 => block.plane = Some(Plane::Yz),
        200 | 700 => block.inch = Some(true),
        210 | 710 => block.inch = Some(false),
        610 => block.exact_stop = Some(true),
        640 => block.exact_stop = Some(false),
        900 => block.incremental = Some(false),
        910 => block.incremental = Some(true),
        // G40, G49, G94: as it always is.
        _ => {}
    }
}

fn miscellaneous(word: &Word, block: &mut Block, groups: &mut Groups, problems: &mut Problems) {
    let code = if word.value.fract() == 0.0 {
        word.value as i64
    } else {
        -1
    };
    match code {
        0..=2 | 30 => {
            if groups.enter("whether to stop", word, problems) {
                let stop = match code {
                    0 => Stop::Pause,
                    1 => Stop::OptionalPause,
                    _ => Stop::End,
                };
                block.stop = Some((word.place, stop));
            }
        }
        3..=5 => {
            if groups.enter("what the spindle does", word, problems) {
                let turn = match code {
                    3 => Turn::Clockwise,
                    4 => Turn::CounterClockwise,
                    _ => Turn::Off,
                };
                block.spindle = Some((word.place, turn));
            }
        }
        _ => {
            let remedy = match code {
                6 => "this machine has one tool: take it out, one program for each tool",
                7..=9 => "this machine has no coolant: take it out",
                98 | 99 => "subprograms are not known: write the moves out",
                _ => "take it out if the part can do without it",
            };
            problems.add(word.place, format!("{} is not known", word.text), remedy);
        }
    }
}

/// Words that need another one, and ranges.
fn check_companions(block: &Block, problems: &mut Problems) {
    if let Some(word) = &block.feed
        && word.value <= 0.0
    {
        problems.add(
            word.place,
            format!("feed {} is not above zero", word.text),
            "write a positive feed",
        );
    }
    if let Some(word) = &block.speed
        && !(word.value.fract() == 0.0 && (0.0..=f64::from(i16::MAX)).contains(&word.value))
    {
        let what = format!("{} is not a spindle speed", word.text);
        problems.add(
            word.place,
            what,
            "write a whole number of rev/min from 0 to 32767",
        );
    }
    match (&block.dwell, &block.seconds) {
        (Some(place), None) => problems.add(
            *place,
            "G4 without its time",
            "write P with the seconds to wait",
        ),
        (Some(_), Some(word)) if !(0.0..=LONGEST_DWELL_S).contains(&word.value) => {
            problems.add(
                word.place,
                format!("{} is not a time to wait", word.text),
                "write 0 to 3600 seconds",
            );
        }
        (None, Some(word)) => {
            problems.add(
                word.place,
                format!("{} belongs to no word of its block", word.text),
                "P is the time of G4: write G4, or take it out",
            );
        }
        _ => {}
    }
    if block.dwell.is_some()
        && let Some(word) = block.first_axis()
    {
        problems.add(
            word.place,
            "an axis word in the block of G4",
            "write the move in a block of its own",
        );
    }
}
