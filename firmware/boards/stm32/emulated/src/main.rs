//! Runs the image of the STM32 board in rigless, records its outputs, and moves its inputs.
//!
//! `serve` is for a host program at the other end of the line; `check` needs none.

mod board;
mod chip;
mod scenes;
mod wired;

use board::{B, Board, D, E, EMERGENCY_STOP, ENCODERS};
use rigless::emulator::{AccessKind, Driver, Host, Settled, Start, Stop, run};
use rigless::image::Image;
use rigless::session::Session;
use rigless::time::VirtualNanos;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

const HELP: &str = "usage: haptimill-stm32-emulated check IMAGE
       haptimill-stm32-emulated run IMAGE [SCENE ...]
       haptimill-stm32-emulated serve IMAGE PORT MILLISECONDS FILE.vcd [STEPS [OPEN_US] | turn]
`check` looks at the control period, the step clock, the encoders and the emergency stop.
`run` has a simulated mill at the pins. Its scenes: `program` homes it, runs a part program, and
compares every pulse edge; `inputs` moves the other inputs.
`serve` waits for a host at tcp:127.0.0.1:PORT and writes the pins at the end. The emergency stop
opens after STEPS steps of joint x for OPEN_US [default: 50000]. With `turn` each encoder has
300 counts more after 30 ms.";

/// Step and direction pins of joints 0 to 4 at port E.
const STEPS: [(u8, u8); 5] = [(4, 10), (5, 12), (6, 14), (7, 15), (8, 2)];
const NAMES: [&str; 5] = ["x", "y", "z", "a", "b"];
/// Enable and charge pump at port B, LED at port D.
const ENABLE: u8 = 12;
const PUMP: u8 = 13;
const LED: u8 = 12;

/// Recorded lines: a time in ns, and the levels of all of them.
#[derive(Default)]
pub struct Lines {
    levels: u16,
    changes: Vec<(u64, u16)>,
}

impl Lines {
    fn note(&mut self, at: u64, levels: u16) {
        if levels != self.levels {
            self.levels = levels;
            self.changes.push((at, levels));
        }
    }

    /// Times of the edges of a pin.
    fn edges(&self, pin: u8) -> Vec<(u64, bool)> {
        let mut before = false;
        let mut edges = Vec::new();
        for (at, levels) in &self.changes {
            let level = levels >> pin & 1 != 0;
            if level != before {
                edges.push((*at, level));
                before = level;
            }
        }
        edges
    }
}

const MS: u64 = 1_000_000;

/// A change of an input.
type Action = (u64, (usize, u8), bool);

struct Bench {
    started: bool,
    /// Looks at the captured index counts.
    with_encoders: bool,
    until: u64,
    /// Changes of inputs, the next one last.
    actions: Vec<Action>,
    port_b: Lines,
    port_d: Lines,
    port_e: Lines,
    /// Captured index counts of each encoder, each new one.
    indices: [Vec<u32>; 4],
    /// Times at which the interrupt of the control period began.
    periods: Vec<u64>,
    /// Time at which the timer of the control period is stopped.
    hang_at: Option<u64>,
    /// Steps of joint x after which the emergency stop opens.
    stop_after: Option<usize>,
    steps: usize,
    /// Time for which it is open, ns.
    open: u64,
    /// Time at which it was opened, and whether it is closed again.
    stopped: Option<u64>,
    closed: bool,
    /// Time at which the gate of TIM8 gets its second edge.
    gate: Option<u64>,
}

/// Status of TIM1, which the interrupt of the control period writes first.
const TIM1_STATUS: u64 = 0x4001_0010;
/// Registers of the ports.
const PORTS: std::ops::Range<u64> = 0x4002_0000..0x4002_2000;
/// Mode of TIM8, whose gate is the emergency stop.
const TIM8_SLAVE: u64 = 0x4001_0408;

impl Bench {
    fn new(until: u64, mut actions: Vec<Action>) -> Self {
        actions.sort_by(|a, b| b.0.cmp(&a.0));
        Self {
            started: false,
            with_encoders: false,
            until,
            actions,
            port_b: Lines::default(),
            port_d: Lines::default(),
            port_e: Lines::default(),
            indices: Default::default(),
            periods: Vec::new(),
            hang_at: None,
            stop_after: None,
            steps: 0,
            open: 50 * MS,
            stopped: None,
            closed: false,
            gate: None,
        }
    }

    fn next(&self) -> u64 {
        self.actions.last().map_or(self.until, |action| action.0)
    }
}

impl Driver<Board> for Bench {
    fn on_settled(&mut self, session: &mut Session<Board>, _: &mut dyn Host, settled: Settled) {
        let mut written = false;
        let at = match settled {
            Settled::Access { access, .. } => {
                if access.address == TIM1_STATUS && access.kind == AccessKind::Write {
                    self.periods.push(access.virtual_time.0);
                }
                if access.address == TIM8_SLAVE && access.kind == AccessKind::Write {
                    let at = access.virtual_time;
                    session.board_mut().drive_gate(at, true);
                    self.gate = Some(at.0 + 5_000);
                }
                written = access.kind == AccessKind::Write && PORTS.contains(&access.address);
                access.virtual_time
            }
            Settled::Stop(stop) => stop.at,
            _ => return,
        };
        let board = session.board_mut();
        if !self.started {
            self.started = true;
            board.rest(at);
        }
        if self.hang_at.is_some_and(|hang| at.0 >= hang) {
            self.hang_at = None;
            board.stop_periods(at);
        }
        let moved = board.acknowledge(at);
        if self.gate.is_some_and(|gate| at.0 >= gate) {
            self.gate = None;
            board.drive_gate(at, false);
        }
        // Only the DMA and writes of the core change an output.
        if moved || written {
            let levels = board.outputs(E);
            let rising = levels & !self.port_e.levels;
            self.steps += usize::from(rising >> STEPS[0].0 & 1);
            self.port_e.note(at.0, levels);
            if self.stop_after.is_some_and(|steps| self.steps == steps) {
                self.stop_after = None;
                self.stopped = Some(at.0);
                board.drive(at, EMERGENCY_STOP, true);
            }
        }
        if self
            .stopped
            .is_some_and(|stopped| at.0 >= stopped + self.open)
            && !self.closed
        {
            self.closed = true;
            board.drive(at, EMERGENCY_STOP, false);
        }
        if written {
            self.port_b.note(at.0, board.outputs(B));
            self.port_d.note(at.0, board.outputs(D));
        }
        if !self.with_encoders {
            return;
        }
        for (encoder, seen) in self.indices.iter_mut().enumerate() {
            let now = board.index(encoder);
            if seen.last().copied().unwrap_or(0) != now {
                seen.push(now);
            }
        }
    }

    fn on_stop(
        &mut self,
        session: &mut Session<Board>,
        stop: Stop,
        _: &mut dyn Host,
    ) -> Option<VirtualNanos> {
        while let Some((at, pin, high)) = self.actions.last().copied() {
            if at > stop.at.0 {
                break;
            }
            session.board_mut().drive(stop.at, pin, high);
            self.actions.pop();
        }
        (stop.at.0 < self.until).then(|| VirtualNanos(self.next()))
    }
}

/// Runs the image; the bench after it, and what the emulator could not model.
fn emulate(image: &str, board: Board, bench: Bench) -> Result<(Bench, After), String> {
    let images = [Image::read(&PathBuf::from(image), None).map_err(|error| error.to_string())?];
    let first = VirtualNanos(bench.next());
    let session = Session::new(Box::new(board), 0, first).map_err(|error| error.to_string())?;
    let finished = run(session, &Start::new(&images), bench).map_err(|error| error.to_string())?;
    let resets = finished.session.resets().len();
    let mut gaps: Vec<String> = Vec::new();
    for (at, it) in finished.session.unimplemented() {
        gaps.push(format!("not modelled: {at:#010x} {it:?}"));
    }
    for it in finished.session.unmapped() {
        gaps.push(format!("no such address: {it:?}"));
    }
    Ok((finished.driver, After { resets, gaps }))
}

/// What is known of the board after a run.
struct After {
    resets: usize,
    gaps: Vec<String>,
}

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let result = match words[..] {
        ["check", image] => check(image),
        ["run", image] => scenes::run(image, &scenes::ALL),
        ["run", image, ref names @ ..] => scenes::run(image, names),
        ["serve", image, port, until, vcd, ref rest @ ..] => serve(image, port, until, vcd, rest),
        _ => Err(HELP.to_string()),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn number(word: &str) -> Result<u64, String> {
    word.parse().map_err(|_| format!("'{word}' is no number"))
}

/// Serves a host, and writes the pins.
fn serve(image: &str, port: &str, until: &str, vcd: &str, rest: &[&str]) -> Result<(), String> {
    let until = number(until)? * 1_000_000;
    let actions = if rest == ["turn"] {
        turns()
    } else {
        Vec::new()
    };
    let mut bench = Bench::new(until, actions);
    if let [steps, open @ ..] = rest
        && *steps != "turn"
    {
        bench.stop_after = Some(number(steps)? as usize);
        if let [open] = open {
            bench.open = number(open)? * 1000;
        }
    }
    let board = Board::new(Some(number(port)? as u16), 8_000_000)?;
    let (bench, after) = emulate(image, board, bench)?;
    for gap in &after.gaps {
        println!("{gap}");
    }
    println!("resets {}", after.resets);
    println!("{}", computation(&bench));
    if let Some(stopped) = bench.stopped {
        let lines = STEPS.iter().flat_map(|(step, _)| bench.port_e.edges(*step));
        let rises = lines.filter(|edge| edge.1).map(|edge| edge.0);
        let first_after = rises.filter(|at| *at > stopped);
        let within: Vec<u64> = first_after
            .map(|at| at - stopped)
            .filter(|ns| *ns < 50 * MS)
            .collect();
        let drives = bench.port_b.edges(ENABLE);
        let off = drives.iter().find(|edge| !edge.1 && edge.0 > stopped);
        println!(
            "emergency stop at {stopped} ns: steps in the 50 ms after it, in ns: {within:?}; drives off after {:?} ns",
            off.map(|edge| edge.0 - stopped)
        );
    }
    for (joint, (step, direction)) in STEPS.iter().enumerate() {
        let steps = bench.port_e.edges(*step);
        let rising: Vec<u64> = steps.iter().filter(|it| it.1).map(|it| it.0).collect();
        let levels = &bench.port_e.changes;
        let sum: i64 = rising
            .iter()
            .map(|at| {
                let change = levels.partition_point(|change| change.0 <= *at) - 1;
                if levels[change].1 >> direction & 1 != 0 {
                    1
                } else {
                    -1
                }
            })
            .sum();
        println!("joint {}: {} steps, sum {sum}", NAMES[joint], rising.len());
    }
    std::fs::write(vcd, dump(&bench)).map_err(|error| format!("{vcd}: {error}"))
}

/// Instructions from the start of a control period to its end, by the time of the emulator: 4 ns
/// each.
fn computation(bench: &Bench) -> String {
    let ends = bench.port_b.edges(PUMP);
    let taken = ends.iter().filter_map(|(end, _)| {
        let next = bench.periods.partition_point(|start| start <= end);
        Some((end - bench.periods.get(next.checked_sub(1)?)?) / 4)
    });
    let mut taken: Vec<u64> = taken.collect();
    taken.sort_unstable();
    let at = |part: usize| taken.get(taken.len() * part / 1000).copied().unwrap_or(0);
    let max = taken.last().copied().unwrap_or(0);
    format!(
        "{} periods begun, {} completed; instructions of a period: median {}, 99.9 % {}, most {max}",
        bench.periods.len(),
        ends.len(),
        at(500),
        at(999)
    )
}

/// Step, direction and enable lines as a value change dump.
fn dump(bench: &Bench) -> String {
    let mut text = String::from("$timescale 1 ns $end\n$scope module stm32 $end\n");
    let mut changes: Vec<(u64, usize, bool)> = Vec::new();
    let mut names = Vec::new();
    for (joint, (step, direction)) in STEPS.iter().enumerate() {
        names.push(format!("{}_step", NAMES[joint]));
        names.push(format!("{}_dir", NAMES[joint]));
        for (at, level) in bench.port_e.edges(*step) {
            changes.push((at, 2 * joint, level));
        }
        for (at, level) in bench.port_e.edges(*direction) {
            changes.push((at, 2 * joint + 1, level));
        }
    }
    names.push("enable".to_string());
    for (at, level) in bench.port_b.edges(ENABLE) {
        changes.push((at, names.len() - 1, level));
    }
    changes.sort();
    let id = |line: usize| char::from(b'!' + line as u8);
    for (line, name) in names.iter().enumerate() {
        let _ = writeln!(text, "$var wire 1 {} {name} $end", id(line));
    }
    text.push_str("$upscope $end\n$enddefinitions $end\n#0\n");
    for line in 0..names.len() {
        let _ = writeln!(text, "0{}", id(line));
    }
    let mut last = 0;
    for (at, line, level) in changes {
        if at != last {
            let _ = writeln!(text, "#{at}");
            last = at;
        }
        let _ = writeln!(text, "{}{}", u8::from(level), id(line));
    }
    let _ = writeln!(text, "#{}", bench.until);
    text
}

/// A condition of a check.
fn require(holds: bool, what: &str) -> Result<(), String> {
    println!("{} {what}", if holds { "ok    " } else { "FAILED" });
    if holds { Ok(()) } else { Err(what.to_string()) }
}

/// Spacings of times.
fn spacings(times: impl Iterator<Item = u64>) -> Vec<u64> {
    let times: Vec<u64> = times.collect();
    times.windows(2).map(|pair| pair[1] - pair[0]).collect()
}

/// Encoder k turns forwards by 400 counts, 4 us a count, from 20 ms on, then back by 100 counts.
/// Its index is high at count 200, and at the end.
fn turns() -> Vec<Action> {
    let mut actions: Vec<Action> = Vec::new();
    let phases = [(false, false), (true, false), (true, true), (false, true)];
    for (encoder, (pins, _)) in ENCODERS.iter().enumerate() {
        let mut at = (20 + encoder as u64) * MS;
        let mut place = 0_i32;
        for turn in 0..500 {
            place += if turn < 400 { 1 } else { -1 };
            let (a, b) = phases[place as usize % 4];
            actions.push((at, pins[0], a));
            actions.push((at, pins[1], b));
            if turn < 400 && place == 200 {
                actions.push((at + 1000, pins[2], true));
            }
            if turn < 400 && place == 201 {
                actions.push((at + 1000, pins[2], false));
            }
            at += 4_000;
        }
        actions.push((at, pins[2], true));
    }
    actions
}

/// Checks that need no host.
fn check(image: &str) -> Result<(), String> {
    let board = Board::new(None, 8_000_000)?;
    let mut bench = Bench::new(40 * MS, turns());
    bench.with_encoders = true;
    let (bench, after) = emulate(image, board, bench)?;
    for gap in &after.gaps {
        println!("{gap}");
    }
    let start = bench.port_b.edges(PUMP).first().map_or(0, |it| it.0);
    println!("first control period completed after {} us", start / 1000);
    let all = spacings(bench.periods.iter().skip(1).copied());
    let (min, max) = (all.iter().min(), all.iter().max());
    println!("{} periods begin {min:?} to {max:?} ns apart", all.len());
    require(after.resets == 0, "no reset in 40 ms")?;
    require(
        all.len() >= 190 && all.iter().all(|ns| ns.abs_diff(200_000) < 1_000),
        "a control period begins every 200 us",
    )?;
    let pumped = bench.port_b.edges(PUMP).len();
    require(
        pumped.abs_diff(bench.periods.len()) <= 1,
        "every control period is completed",
    )?;
    println!("captured indices {:?}", bench.indices);
    require(
        bench.indices.iter().all(|seen| seen[..] == [200, 300]),
        "each encoder has 200 counts at its first index pulse, and 400 - 100 at its second",
    )?;
    require(
        STEPS
            .iter()
            .all(|(step, _)| bench.port_e.edges(*step).is_empty()),
        "no step without a command",
    )?;
    require(bench.port_b.edges(ENABLE).is_empty(), "the drives are off")?;

    let board = Board::new(None, 0)?;
    let (bench, after) = emulate(image, board, Bench::new(6_000 * MS, vec![]))?;
    let flashes = bench.port_d.edges(LED);
    let on: Vec<u64> = flashes
        .iter()
        .filter(|it| it.1)
        .map(|it| it.0 / MS)
        .collect();
    println!("without a crystal: LED on at {on:?} ms");
    require(
        on.len() > 5 && on[5] - on[4] > 800 && on[4] - on[3] < 400,
        "without a crystal the LED flashes five times, then pauses",
    )?;
    require(after.resets == 0, "and the chip is not reset")?;

    // The emergency stop is open: without the step clock the emulator is faster.
    let board = Board::new(None, 8_000_000)?;
    let mut bench = Bench::new(2_500 * MS, vec![(MS / 2, EMERGENCY_STOP, true)]);
    bench.hang_at = Some(20 * MS);
    let (bench, after) = emulate(image, board, bench)?;
    let last = bench.periods.iter().rfind(|at| **at < 21 * MS);
    let last = last.copied().unwrap_or(0);
    let next = bench.periods.iter().find(|at| **at > last);
    let gap = next.map_or(0, |next| (next - last) / MS);
    let flashes = bench.port_d.edges(LED);
    let on: Vec<u64> = flashes
        .iter()
        .filter(|it| it.1)
        .map(|it| it.0 / MS)
        .collect();
    println!("the timer stops at 20 ms: next control period {gap} ms later, LED on at {on:?} ms");
    require(after.resets == 1, "the watchdog resets the chip once")?;
    require((15..30).contains(&gap), "20 ms after the last period")?;
    require(
        on.len() >= 3 && on[1] - on[0] < 400 && on[2] - on[1] > 800,
        "the LED then flashes twice, then pauses",
    )
}
