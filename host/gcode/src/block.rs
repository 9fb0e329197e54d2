//! Blocks: assigns the words of a line to their meanings, at most one word per modal group.

use super::lexer::{Line, Word};
use super::problem::{Place, Problems};
use super::{LONGEST_DWELL_S, Options};

/// G0 to G3, or none.
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

/// Direction of the spindle.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Turn {
    /// Off (M5).
    #[default]
    Off,
    /// M3.
    Clockwise,
    /// M4.
    CounterClockwise,
}

/// Words of a block by meaning.
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
    /// Whether a problem was found; the motion of the block is then not used.
    pub has_problem: bool,
}

impl Block {
    /// Returns the first axis word.
    pub(crate) fn first_axis(&self) -> Option<&Word> {
        self.axes.iter().flatten().min_by_key(|word| word.place)
    }
}

/// Modal groups of a block; each may have one word.
#[derive(Default)]
struct ModalGroups {
    words: Vec<(&'static str, String)>,
}

impl ModalGroups {
    fn enter(&mut self, group: &'static str, word: &Word, problems: &mut Problems) -> bool {
        if let Some((_, first)) = self.words.iter().find(|(known, _)| *known == group) {
            let what = format!(
                "{} and {first} in one block: both are of modal group {group}",
                word.text
            );
            problems.add(word.place, what, "keep one");
            return false;
        }
        self.words.push((group, word.text.clone()));
        true
    }
}

/// Reads the words of a line as a block. `first_block` allows an O word.
pub fn read_block(
    line: &Line,
    options: &Options,
    first_block: bool,
    problems: &mut Problems,
) -> Block {
    let before = problems.count();
    let mut block = Block::default();
    let mut groups = ModalGroups::default();
    let mut letters: Vec<char> = Vec::new();
    for (index, word) in line.words.iter().enumerate() {
        let letter = word.letter;
        if letter != 'G' && letter != 'M' {
            if letters.contains(&letter) {
                let what = format!("the letter {letter} occurs twice in one block");
                problems.add(word.place, what, "keep one");
                continue;
            }
            letters.push(letter);
        }
        let slot = match letter {
            'G' => {
                read_g(word, &mut block, &mut groups, problems);
                continue;
            }
            'M' => {
                read_m(word, &mut block, &mut groups, problems);
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
                        "write a whole number from 0, or remove it",
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
    block.has_problem = line.has_problem || problems.count() > before;
    block
}

/// Returns problem and remedy of a letter that is not supported.
fn unknown_letter(word: &Word) -> (String, &'static str) {
    let text = &word.text;
    match word.letter {
        'T' => (
            format!("tool change {text} is not possible: this machine has one tool"),
            "remove the T word; write one program per tool",
        ),
        'X' | 'Y' | 'Z' | 'A' | 'B' | 'C' | 'U' | 'V' | 'W' => (
            format!("{text}: this machine has no axis {}", word.letter),
            "write the program for the axes of the machine file",
        ),
        'D' | 'H' => (
            format!("{text}: tool offsets are not supported"),
            "let the CAM program apply the tool offset",
        ),
        'E' => (
            format!("{text}: exponents are not supported"),
            "write all digits of the number",
        ),
        'O' => (
            format!("program number {text} is not alone in the first block"),
            "remove it; subprograms are not supported",
        ),
        _ => (
            format!("{text} is not supported"),
            "remove it, or put it in a comment ( )",
        ),
    }
}

/// Reads a G word.
fn read_g(word: &Word, block: &mut Block, groups: &mut ModalGroups, problems: &mut Problems) {
    // Tenths, for words such as G61.1.
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
        if groups.enter("motion", word, problems) {
            block.motion = Some((word.place, motion));
        }
        return;
    }
    let group = match code {
        40 => "dwell",
        170 | 180 | 190 => "plane",
        200 | 210 | 700 | 710 => "unit",
        400 => "cutter compensation",
        490 => "tool length",
        610 | 640 => "path control",
        900 | 910 => "distance",
        940 => "feed mode",
        _ => {
            let remedy = match code {
                410 | 420 => "cutter compensation is not supported: let the CAM program apply it",
                430..=439 => "the tool length is in the machine file: remove it",
                530..=599 => {
                    "there is one work coordinate system, that of the machine file: remove it"
                }
                280..=309 => "write the move as G0 with its coordinates",
                730 | 810..=899 => "drilling cycles are not supported: write their moves",
                930 | 950 => "write feeds per minute (G94)",
                901 => "centres are from the start of the arc (G91.1)",
                _ => "remove it if the part does not need it",
            };
            problems.add(
                word.place,
                format!("{} is not supported", word.text),
                remedy,
            );
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
        // G40, G49, G94 change nothing.
        _ => {}
    }
}

/// Reads an M word.
fn read_m(word: &Word, block: &mut Block, groups: &mut ModalGroups, problems: &mut Problems) {
    let code = if word.value.fract() == 0.0 {
        word.value as i64
    } else {
        -1
    };
    match code {
        0..=2 | 30 => {
            if groups.enter("stop", word, problems) {
                let stop = match code {
                    0 => Stop::Pause,
                    1 => Stop::OptionalPause,
                    _ => Stop::End,
                };
                block.stop = Some((word.place, stop));
            }
        }
        3..=5 => {
            if groups.enter("spindle", word, problems) {
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
                6 => "this machine has one tool: remove it, one program for each tool",
                7..=9 => "this machine has no coolant: remove it",
                98 | 99 => "subprograms are not supported: write their moves",
                _ => "remove it if the part does not need it",
            };
            problems.add(
                word.place,
                format!("{} is not supported", word.text),
                remedy,
            );
        }
    }
}

/// Checks ranges, and words that need another word.
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
                format!("{} is not a dwell time", word.text),
                "write 0 to 3600 seconds",
            );
        }
        (None, Some(word)) => {
            problems.add(
                word.place,
                format!("{} belongs to no word of its block", word.text),
                "P is the time of G4: write G4, or remove it",
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
