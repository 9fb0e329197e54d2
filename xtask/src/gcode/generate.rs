//! Generated part programs for the comparison: valid by construction, by seed.

use std::fmt::Write;

/// Random numbers (SplitMix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut value = self.0;
        value = (value ^ (value >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        value = (value ^ (value >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        value ^ (value >> 31)
    }

    fn below(&mut self, count: u64) -> u64 {
        self.next() % count
    }

    /// Returns a number with three decimals.
    fn within(&mut self, low: f64, high: f64) -> f64 {
        let share = self.below(1_000_001) as f64 * 1e-6;
        ((low + (high - low) * share) * 1000.0).round() * 1e-3
    }
}

/// A program while it is written; the position is in program coordinates.
struct Writer {
    text: String,
    random: Random,
    at: [f64; 3],
    incremental: bool,
    absolute_centres: bool,
    plane: [usize; 3],
    label: u32,
}

const NAMES: [char; 3] = ['X', 'Y', 'Z'];
const CENTRES: [char; 3] = ['I', 'J', 'K'];

impl Writer {
    fn line(&mut self, text: &str) {
        self.text.push_str(text);
        self.text.push('\n');
    }

    /// Returns words that lead to a position.
    fn words(&mut self, to: [f64; 3], all: bool) -> String {
        let mut words = String::new();
        for axis in 0..3 {
            let step = to[axis] - self.at[axis];
            if step == 0.0 && !all {
                continue;
            }
            let value = if self.incremental { step } else { to[axis] };
            let name = NAMES[axis];
            let _ = match self.random.below(8) {
                0 => write!(words, " {name}[{:.6} + 1]", value - 1.0),
                1 => write!(words, " {} {value:.6}", name.to_ascii_lowercase()),
                _ => write!(words, " {name}{value:.6}"),
            };
        }
        self.at = to;
        words
    }

    fn somewhere(&mut self) -> [f64; 3] {
        std::array::from_fn(|axis| match self.random.below(3) {
            0 => self.at[axis],
            _ => self.random.within(-40.0, 40.0),
        })
    }

    fn move_straight(&mut self) {
        let to = self.somewhere();
        let code = if self.random.below(3) == 0 {
            "G0"
        } else {
            "G1"
        };
        // Where only rotary axes move, F is in degrees, and the comparison takes it as a length.
        let is_turned = to != self.at && !self.incremental && self.random.below(4) == 0;
        let mut words = self.words(to, true);
        if is_turned {
            let turn = self.random.within(-180.0, 180.0);
            let letter = ['A', 'B', 'C'][self.random.below(3) as usize];
            let _ = write!(words, " {letter}{turn:.3}");
        }
        if code == "G1" && self.random.below(6) == 0 {
            let rate = self.random.within(0.5, 90.0);
            self.line(&format!("G93 {code}{words} F{rate:.3}"));
            let feed = self.random.within(10.0, 900.0);
            self.line(&format!("G94 F{feed}"));
            return;
        }
        self.line(&format!("{code}{words}"));
    }

    fn arc(&mut self) {
        let [first, second, normal] = self.plane;
        let radius = self.random.within(0.5, 20.0);
        let start = self.random.within(-3.1, 3.1);
        let sweep = self.random.within(0.1, 6.0);
        let clockwise = self.random.below(2) == 0;
        let turn = if clockwise { -sweep } else { sweep };
        let offset = [-radius * start.cos(), -radius * start.sin()];
        let centre = [self.at[first] + offset[0], self.at[second] + offset[1]];
        let mut to = self.at;
        to[first] = centre[0] + radius * (start + turn).cos();
        to[second] = centre[1] + radius * (start + turn).sin();
        if self.random.below(3) == 0 {
            to[normal] = self.random.within(-20.0, 20.0);
        }
        let code = if clockwise { "G2" } else { "G3" };
        let words = self.words(to, true);
        // Near half a turn and a full turn, the arc by radius is ill-conditioned.
        let by_radius = (sweep - std::f64::consts::PI).abs() > 0.3 && sweep < 5.5;
        if by_radius && self.random.below(3) == 0 {
            let sign = if sweep > std::f64::consts::PI {
                "-"
            } else {
                ""
            };
            self.line(&format!("{code}{words} R{sign}{radius:.6}"));
            return;
        }
        let values = if self.absolute_centres {
            centre
        } else {
            offset
        };
        let turns = match self.random.below(5) {
            0 => " P3",
            _ => "",
        };
        self.line(&format!(
            "{code}{words} {}{:.6} {}{:.6}{turns}",
            CENTRES[first], values[0], CENTRES[second], values[1]
        ));
    }

    fn cycle(&mut self) {
        let normal = self.plane[2];
        // Outside G17 `rs274` taps at other coordinates.
        let count = if normal == 2 { 10 } else { 6 };
        let code = [73, 81, 82, 83, 85, 89, 74, 84, 86, 87][self.random.below(count) as usize];
        match code {
            74 => self.line("M4 S500"),
            84 | 86 | 87 => self.line("M3 S500"),
            _ => {}
        }
        let (r, depth) = (self.random.within(1.0, 5.0), self.random.within(-9.0, -1.0));
        let back = if self.random.below(2) == 0 { 98 } else { 99 };
        self.line("G90");
        self.incremental = false;
        let mut to = self.at;
        to[normal] = self.random.within(6.0, 9.0);
        let words = self.words(to, false);
        self.line(&format!("G0{words}"));
        let level = self.at[normal];
        let mut words = format!("G{back} G{code} R{r} {}{depth}", NAMES[normal]);
        words += match code {
            73 | 83 => " Q0.70001",
            82 | 86 | 89 => " P0.1",
            87 => " I0.5 J-0.25 K0.5",
            _ => "",
        };
        let (a, b) = (self.plane[0], self.plane[1]);
        for hole in 0..1 + self.random.below(3) {
            let at = [
                self.random.within(-30.0, 30.0),
                self.random.within(-30.0, 30.0),
            ];
            (self.at[a], self.at[b]) = (at[0], at[1]);
            let place = format!("{}{:.3} {}{:.3}", NAMES[a], at[0], NAMES[b], at[1]);
            self.line(&if hole == 0 {
                format!("{words} {place}")
            } else {
                place
            });
        }
        self.line("G80");
        self.at[normal] = if back == 98 { level } else { r };
    }

    /// A change of offsets, and an absolute move.
    fn offset(&mut self) {
        let value = |random: &mut Random| random.within(-15.0, 15.0);
        let text = match self.random.below(22) {
            0 => format!(
                "G10 L2 P2 X{} Y{} Z{}",
                value(&mut self.random),
                value(&mut self.random),
                value(&mut self.random)
            ),
            1 => "G55".into(),
            2 => "G54".into(),
            3 => format!(
                "G92 X{} Z{}",
                value(&mut self.random),
                value(&mut self.random)
            ),
            4 => "G92.1".into(),
            5 => format!("G43 H{}", 1 + self.random.below(20)),
            6 => "G49".into(),
            7 if self.plane[2] == 2 => {
                format!("G10 L2 P2 R{}", self.random.within(-60.0, 60.0))
            }
            8 => format!("G10 L20 P1 X{} Y1", value(&mut self.random)),
            9 => "G28".into(),
            10 => format!("G91 G28 Z{:.3}", self.random.within(-2.0, 2.0)),
            11 => "G90 G30".into(),
            12 => "G28.1".into(),
            13 => "G30.1".into(),
            14 => format!(
                "G52 X{} Y{}",
                value(&mut self.random),
                value(&mut self.random)
            ),
            15 => "G52 X0 Y0 Z0".into(),
            16 => format!("G43.2 H{}", 1 + self.random.below(20)),
            17 => "G92.2".into(),
            18 => "G92.3".into(),
            19 => format!(
                "G10 L2 P{} X{} Z{}",
                3 + self.random.below(7),
                value(&mut self.random),
                value(&mut self.random)
            ),
            20 => ["G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3"]
                [self.random.below(7) as usize]
                .into(),
            _ => "G10 L2 P2 R0".into(),
        };
        self.line(&text);
        self.line("G90");
        self.incremental = false;
        let to: [f64; 3] = std::array::from_fn(|_| self.random.within(-30.0, 30.0));
        let words = self.words(to, true);
        self.line(&format!("G0{words}"));
    }

    fn mode(&mut self) {
        match self.random.below(6) {
            0 => {
                self.line("G91");
                self.incremental = true;
            }
            1 => {
                self.line("G90");
                self.incremental = false;
            }
            2 => {
                self.line("G90.1");
                self.absolute_centres = true;
            }
            3 => {
                self.line("G91.1");
                self.absolute_centres = false;
            }
            _ => {
                let feed = self.random.within(10.0, 900.0);
                self.line(&format!("F{feed}"));
            }
        }
    }

    fn contour(&mut self) {
        self.line("G90 G17 G91.1");
        (self.incremental, self.absolute_centres) = (false, false);
        let side = if self.random.below(2) == 0 { 41 } else { 42 };
        let [x, y] = [
            self.random.within(-20.0, 20.0),
            self.random.within(-20.0, 20.0),
        ];
        self.line(&format!("G0 X{:.6} Y{:.6}", x - 10.0, y - 10.0));
        let diameter = self.random.within(0.5, 3.0);
        self.line(&format!("G{side}.1 D{diameter:.6}"));
        self.line(&format!("G1 X{x:.6} Y{y:.6}"));
        let (mut at, mut heading) = ([x, y], self.random.within(-0.5, 0.5));
        for _ in 0..4 + self.random.below(6) {
            heading += self.random.within(-1.4, 1.4);
            if self.random.below(3) == 0 {
                let (radius, sweep) = (self.random.within(8.0, 15.0), self.random.within(0.6, 1.5));
                let turn = if self.random.below(2) == 0 { 1.0 } else { -1.0 };
                let normal = heading + turn * std::f64::consts::FRAC_PI_2;
                let offset = [radius * normal.cos(), radius * normal.sin()];
                heading += turn * sweep;
                let centre = [at[0] + offset[0], at[1] + offset[1]];
                let normal = heading + turn * std::f64::consts::FRAC_PI_2;
                at = [
                    centre[0] - radius * normal.cos(),
                    centre[1] - radius * normal.sin(),
                ];
                let code = if turn > 0.0 { "G3" } else { "G2" };
                self.line(&format!(
                    "{code} X{:.6} Y{:.6} I{:.6} J{:.6}",
                    at[0], at[1], offset[0], offset[1]
                ));
                // The next block is a line without a code.
                self.line("G1");
                continue;
            }
            let length = self.random.within(9.0, 15.0);
            at = [
                at[0] + length * heading.cos(),
                at[1] + length * heading.sin(),
            ];
            self.line(&format!("X{:.6} Y{:.6}", at[0], at[1]));
        }
        self.line("G40");
        self.line(&format!("G0 X{:.6} Y{:.6}", at[0] + 20.0, at[1] + 5.0));
        // The rounded numbers are the position.
        self.at = [
            ((at[0] + 20.0) * 1e6).round() * 1e-6,
            ((at[1] + 5.0) * 1e6).round() * 1e-6,
            self.at[2],
        ];
    }

    fn flow(&mut self) {
        self.label += 1;
        let (label, count) = (self.label, 1 + self.random.below(5));
        self.line("G91");
        let (dx, dy) = (self.random.within(-3.0, 3.0), self.random.within(-3.0, 3.0));
        match self.random.below(3) {
            0 => {
                self.line("#1=0");
                self.line(&format!("O{label} while [#1 LT {count}]"));
                self.line(&format!("  G1 X[{dx}] Y[#1 * 0 + {dy}]"));
                self.line("  #1=[#1 + 1]");
                self.line(&format!("O{label} endwhile"));
            }
            1 => {
                self.line(&format!("O{label} repeat [{count}]"));
                self.line(&format!("  G1 X{dx} Y{dy}"));
                self.line(&format!("O{label} endrepeat"));
            }
            _ => {
                self.line(&format!("O{label} sub"));
                self.line("  G1 X#1 Y#2");
                self.line(&format!("O{label} endsub"));
                for _ in 0..count {
                    self.line(&format!("O{label} call [{dx}] [{dy}]"));
                }
            }
        }
        self.at[0] += dx * count as f64;
        self.at[1] += dy * count as f64;
        self.line(if self.incremental { "G91" } else { "G90" });
    }
}

/// Returns the program of a seed.
pub(super) fn program(seed: u64) -> String {
    let mut writer = Writer {
        text: String::new(),
        random: Random(seed),
        at: [0.0; 3],
        incremental: false,
        absolute_centres: false,
        plane: [0, 1, 2],
        label: 100,
    };
    let (unit, plane) = (writer.random.below(4), writer.random.below(5));
    writer.line(if unit == 0 { "G20" } else { "G21" });
    let (word, axes) = match plane {
        0 => ("G18", [2, 0, 1]),
        1 => ("G19", [1, 2, 0]),
        _ => ("G17", [0, 1, 2]),
    };
    writer.plane = axes;
    writer.line(&format!("{word} G90 F200"));
    for _ in 0..40 {
        match writer.random.below(10) {
            0..=2 => writer.move_straight(),
            3..=5 => writer.arc(),
            6 => writer.cycle(),
            7 => writer.offset(),
            8 => writer.mode(),
            _ if plane > 1 && writer.random.below(2) == 0 => writer.contour(),
            _ => writer.flow(),
        }
    }
    writer.line("G40 G49 G92.1 G54 G80");
    writer.line("M2");
    writer.text
}
