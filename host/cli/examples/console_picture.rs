//! Makes the pictures of docs/console.md: runs the console in a pseudo-terminal, works it with keys, and writes its screen as SVG.
//!
//! `cargo run --release --example console_picture` (after `cargo build --release`), from the root of the workspace.

#[cfg(target_os = "linux")]
#[path = "../tests/terminal/mod.rs"]
mod terminal;

#[cfg(not(target_os = "linux"))]
fn main() {
    eprintln!("a pseudo-terminal of Linux is needed");
}

#[cfg(target_os = "linux")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    linux::main()
}

#[cfg(target_os = "linux")]
mod linux {
    use super::terminal::console::{ENTER, RESUME, RIGHT, STOP, agrees, home, run};
    use super::terminal::{Keyboard, Terminal};
    use std::error::Error;
    use std::fmt::Write as _;
    use std::path::Path;
    use std::time::Duration;

    /// Size of a cell, pixels.
    const CELL: (u32, u32) = (9, 18);

    /// To and fro along x with the button held, for as long as it takes.
    fn person() -> String {
        let strokes: String = (0..20)
            .map(|index| {
                let (at_s, x) = (2 + 4 * index, if index % 2 == 0 { -14.0 } else { 0.0 });
                format!("[[stroke]]\nat_s = {at_s}.0\nto_mm = [{x:.1}, 0.0, 0.0]\npace_mm_s = 5.0\nramp_s = 0.5\n")
            })
            .collect();
        format!("[[button]]\nat_s = 1.0\nheld = true\n{strokes}")
    }

    pub(crate) fn main() -> Result<(), Box<dyn Error>> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let out = std::env::temp_dir();
        let folder = out.to_str().ok_or("not UTF-8")?;
        jog_and_run(&root, folder)?;
        lead(&root, folder)
    }

    /// A number in the row of x under a heading of the overlay, by its place among the words without the bars.
    fn number(text: &str, heading: &str, place: usize) -> Option<f64> {
        let mut rows = text.lines().skip_while(|row| !row.contains(heading));
        let words = rows.nth(1)?.split_whitespace();
        let mut words = words.filter(|word| !word.contains(['·', '█']));
        words.nth(place)?.parse().ok()
    }

    /// The console with the flat block on its table.
    fn console(root: &Path, more: &[&str]) -> Result<Terminal, Box<dyn Error>> {
        // Examples lie in a folder beside the command.
        let me = std::env::current_exe()?;
        let folder = me.parent().and_then(Path::parent).ok_or("no folder")?;
        let program = folder.join("haptimill");
        let arguments = [&["console", "--stock", "examples/block.toml"], more].concat();
        let terminal = Terminal::start(&program, &arguments, root, (80, 24), Keyboard::Plain);
        home(&terminal);
        terminal.sees("the work is clamped");
        agrees(&terminal, b"t", "Tare?");
        terminal.sees("has a new zero");
        Ok(terminal)
    }

    /// A key jogs the machine; a program cuts, with force control along x and a recording.
    fn jog_and_run(root: &Path, out: &str) -> Result<(), Box<dyn Error>> {
        let terminal = console(root, &["--out", out, "examples/e7-slot.ngc"])?;
        terminal.keys(b"f");
        for _ in 0..20 {
            terminal.keys(RIGHT);
            std::thread::sleep(Duration::from_millis(30));
        }
        picture(&terminal, &root.join("docs/console-jog.svg"))?;
        terminal.state("IDLE");
        // Back to where the program begins, exactly: by a step of 10 mm would be elsewhere, so home again.
        agrees(&terminal, b"h", "Home?");
        terminal.state("HOMING");
        terminal.state("IDLE");
        terminal.brings(b"y", "Force loop");
        terminal.brings(ENTER, "x yields");
        terminal.escape();
        terminal.brings(b"l", "REC console-");
        run(&terminal);
        std::thread::sleep(Duration::from_secs(9));
        picture(&terminal, &root.join("docs/console-run.svg"))?;
        terminal.keys(STOP);
        terminal.state("IDLE");
        terminal.brings(b"l", " rows");
        terminal.keys(b"q\r");
        Ok(())
    }

    /// A hand leads x through the block, feels the cut, and is in a wall.
    fn lead(root: &Path, out: &str) -> Result<(), Box<dyn Error>> {
        let own = format!("{out}/haptimill-picture-machine.toml");
        std::fs::write(
            &own,
            [
                haptimill_machine_file::BUILT_IN,
                haptimill_machine_file::HAND,
            ]
            .join("\n"),
        )?;
        let script = format!("{out}/haptimill-picture-person.toml");
        std::fs::write(&script, person())?;
        let terminal = console(
            root,
            &[
                "--machine",
                &own,
                "--operator",
                &script,
                "examples/e8-hand.ngc",
            ],
        )?;
        terminal.brings(b"w", "button held");
        terminal.keys(RIGHT);
        terminal.keys(RIGHT);
        // Half on its way.
        terminal.waits("away", |text| {
            number(text, "at most", 6).is_some_and(|tip| (-9.0..-6.0).contains(&tip))
        });
        terminal.brings(ENTER, "lower wall of x where the tip is");
        terminal.escape();
        run(&terminal);
        terminal.state("HOLD");
        terminal.brings(b"a", "Axes:");
        terminal.brings(b"m", "x: master");
        terminal.escape();
        terminal.keys(RESUME);
        terminal.state("RUN");
        terminal.brings(b"w", "leads x");
        // While the wall is felt, and the cut too.
        terminal.waits("in the wall", |text| {
            let forces = [2, 4, 5].map(|column| number(text, "law", column).unwrap_or_default());
            let [tool, law, wall] = forces;
            // The hand is reported more rarely than the tool: a moment in which both tell of the same cut.
            let fits = (law - 0.4 * tool).abs() < 0.1;
            text.starts_with(" RUN ") && law.abs() > 0.4 && wall > 0.4 && fits
        });
        picture(&terminal, &root.join("docs/console-hand.svg"))?;
        terminal.escape();
        terminal.keys(STOP);
        terminal.state("IDLE");
        terminal.keys(b"q\r");
        std::fs::remove_file(own)?;
        std::fs::remove_file(script)?;
        Ok(())
    }

    /// The colours of a usual terminal.
    fn colour(colour: vt100::Color, default: &'static str) -> &'static str {
        match colour {
            vt100::Color::Idx(0) => "#000000",
            vt100::Color::Idx(1) => "#cc3333",
            vt100::Color::Idx(2) => "#4e9a06",
            vt100::Color::Idx(3) => "#c4a000",
            vt100::Color::Idx(6) => "#06989a",
            vt100::Color::Idx(7) => "#b8bcb4",
            vt100::Color::Idx(15) => "#ffffff",
            _ => default,
        }
    }

    /// Writes the screen. Runs of cells that look the same are one piece, fitted to its cells whatever the font is.
    fn picture(terminal: &Terminal, path: &Path) -> Result<(), Box<dyn Error>> {
        let svg = terminal.with_screen(|screen| -> Result<String, std::fmt::Error> {
            let (rows, columns) = screen.size();
            let (rows, columns) = (rows.get(), columns.get());
            let (width, height) = (u32::from(columns) * CELL.0, u32::from(rows) * CELL.1);
            let mut svg = String::new();
            writeln!(
                svg,
                "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
                 font-family=\"DejaVu Sans Mono, Liberation Mono, Menlo, Consolas, monospace\" font-size=\"15\">\n\
                 <rect width=\"100%\" height=\"100%\" fill=\"#1c1f22\"/>"
            )?;
            for row in 0..rows {
                let mut column = 0;
                while column < columns {
                    let look = |column: u16| {
                        let cell = screen.cell(row, column)?;
                        let (mut ink, mut paper) = (
                            colour(cell.fgcolor(), "#d3d7cf"),
                            colour(cell.bgcolor(), "#1c1f22"),
                        );
                        if cell.inverse() {
                            std::mem::swap(&mut ink, &mut paper);
                        }
                        Some((ink, paper, cell.bold(), cell.dim()))
                    };
                    let first = look(column);
                    let mut text = String::new();
                    let begin = column;
                    while column < columns && look(column) == first {
                        let content = screen.cell(row, column).map_or("", |cell| cell.contents());
                        text.push_str(if content.is_empty() { " " } else { content });
                        column += 1;
                    }
                    let Some((ink, paper, bold, dim)) = first else { continue };
                    let (x, y) = (u32::from(begin) * CELL.0, u32::from(row) * CELL.1);
                    let long = u32::from(column - begin) * CELL.0;
                    if paper != "#1c1f22" {
                        writeln!(svg, "<rect x=\"{x}\" y=\"{y}\" width=\"{long}\" height=\"{}\" fill=\"{paper}\"/>", CELL.1)?;
                    }
                    if text.trim().is_empty() {
                        continue;
                    }
                    let text = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
                    let weight = if bold { " font-weight=\"bold\"" } else { "" };
                    let faint = if dim { " opacity=\"0.65\"" } else { "" };
                    writeln!(
                        svg,
                        "<text x=\"{x}\" y=\"{}\" textLength=\"{long}\" lengthAdjust=\"spacingAndGlyphs\" xml:space=\"preserve\" fill=\"{ink}\"{weight}{faint}>{text}</text>",
                        y + 14
                    )?;
                }
            }
            svg.push_str("</svg>\n");
            Ok(svg)
        })?;
        std::fs::write(path, svg)?;
        println!("{}", path.display());
        Ok(())
    }
}
