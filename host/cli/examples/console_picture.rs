//! Generates the pictures of docs/console.md: runs the console in a pseudo-terminal, operates it
//! with keys, and writes its screen as SVG.
//!
//! `cargo run --release --example console_picture` (after `cargo build --release`), from the root
//! of the workspace.

#[cfg(target_os = "linux")]
#[path = "../tests/terminal/mod.rs"]
#[allow(dead_code, reason = "the tests use all of it")]
mod terminal;

#[cfg(not(target_os = "linux"))]
fn main() {
    eprintln!("this example needs a Linux pseudo-terminal");
}

#[cfg(target_os = "linux")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    linux::main()
}

#[cfg(target_os = "linux")]
mod linux {
    use super::terminal::console::{ENTER, RESUME, RIGHT, STOP, confirm, home, run};
    use super::terminal::{Keyboard, Terminal};
    use std::error::Error;
    use std::fmt::Write as _;
    use std::path::Path;
    use std::time::Duration;

    /// Size of a cell, pixels.
    const CELL: (u32, u32) = (9, 18);

    /// Operator model: motion along x in both directions with the enabling switch pressed.
    fn operator_script() -> String {
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
        teleoperate(&root, folder)
    }

    /// Number in the row of x under a heading of the overlay, by its index among the words without
    /// the bars.
    fn number(text: &str, heading: &str, place: usize) -> Option<f64> {
        let mut rows = text.lines().skip_while(|row| !row.contains(heading));
        let words = rows.nth(1)?.split_whitespace();
        let mut words = words.filter(|word| !word.contains(['·', '█']));
        words.nth(place)?.parse().ok()
    }

    /// The console with the flat block as stock.
    fn console(root: &Path, more: &[&str]) -> Result<Terminal, Box<dyn Error>> {
        // Examples are in a folder beside the command.
        let me = std::env::current_exe()?;
        let folder = me.parent().and_then(Path::parent).ok_or("no folder")?;
        let program = folder.join("haptimill");
        let arguments = [&["console", "--stock", "examples/block.toml"], more].concat();
        let terminal = Terminal::start(&program, &arguments, root, (80, 24), Keyboard::Plain);
        home(&terminal);
        terminal.expect_text("the stock is clamped");
        confirm(&terminal, b"t", "Tare?");
        terminal.expect_text("has a new zero");
        Ok(terminal)
    }

    /// Pictures of a jog, and of a program that cuts with force control along x and a recording.
    fn jog_and_run(root: &Path, out: &str) -> Result<(), Box<dyn Error>> {
        let terminal = console(root, &["--out", out, "examples/e7-slot.ngc"])?;
        terminal.press(b"f");
        for _ in 0..20 {
            terminal.press(RIGHT);
            std::thread::sleep(Duration::from_millis(30));
        }
        picture(&terminal, &root.join("docs/console-jog.svg"))?;
        terminal.expect_state("IDLE");
        // Homing again returns exactly to the start of the program; steps of 10 mm would not.
        confirm(&terminal, b"h", "Home?");
        terminal.expect_state("HOMING");
        terminal.expect_state("IDLE");
        terminal.press_expect(b"y", "Force control:");
        terminal.press_expect(ENTER, "x on   setpoint");
        terminal.escape();
        terminal.press_expect(b"l", "REC console-");
        run(&terminal);
        std::thread::sleep(Duration::from_secs(9));
        picture(&terminal, &root.join("docs/console-run.svg"))?;
        terminal.press(STOP);
        terminal.expect_state("IDLE");
        terminal.press_expect(b"l", " rows");
        terminal.press(b"q\r");
        Ok(())
    }

    /// Picture of a teleoperated cut along x, with force feedback and contact with a virtual
    /// fixture.
    fn teleoperate(root: &Path, out: &str) -> Result<(), Box<dyn Error>> {
        let machine_file = format!("{out}/haptimill-picture-machine.toml");
        std::fs::write(
            &machine_file,
            [
                haptimill_machine_file::BUILT_IN,
                haptimill_machine_file::HAPTIC_ARM,
            ]
            .join("\n"),
        )?;
        let script = format!("{out}/haptimill-picture-operator.toml");
        std::fs::write(&script, operator_script())?;
        let terminal = console(
            root,
            &[
                "--machine",
                &machine_file,
                "--operator",
                &script,
                "examples/e8-teleop.ngc",
            ],
        )?;
        terminal.press_expect(b"w", "enabling switch pressed");
        terminal.press(RIGHT);
        terminal.press(RIGHT);
        // In the middle of its motion.
        terminal.wait_until("away", |text| {
            number(text, "tip, mm", 6).is_some_and(|tip| (-9.0..-6.0).contains(&tip))
        });
        terminal.press_expect(ENTER, "lower face of x set at the tip");
        terminal.escape();
        run(&terminal);
        terminal.expect_state("HOLD");
        terminal.press_expect(b"a", "Coordinate sources:");
        terminal.press_expect(b"m", "x: master");
        terminal.escape();
        terminal.press(RESUME);
        terminal.expect_state("RUN");
        terminal.press_expect(b"w", "drives x");
        // In contact with the fixture while the tool cuts.
        terminal.wait_until("in the fixture", |text| {
            let forces = [2, 4, 5].map(|column| number(text, "law", column).unwrap_or_default());
            let [tool, law, fixture] = forces;
            // The master is reported less often than the tool: wait for reports of the same force.
            let fits = (law - 0.4 * tool).abs() < 0.1;
            text.starts_with(" RUN ") && law.abs() > 0.4 && fixture > 0.4 && fits
        });
        picture(&terminal, &root.join("docs/console-master.svg"))?;
        terminal.escape();
        terminal.press(STOP);
        terminal.expect_state("IDLE");
        terminal.press(b"q\r");
        std::fs::remove_file(machine_file)?;
        std::fs::remove_file(script)?;
        Ok(())
    }

    /// Colours of a common terminal.
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

    /// Foreground and background colour, bold, dim.
    type Style = (&'static str, &'static str, bool, bool);

    /// Background of the terminal.
    const BACKGROUND: &str = "#1c1f22";

    /// Style of a cell; none outside the screen.
    fn style(screen: &vt100::Screen, row: u16, column: u16) -> Option<Style> {
        let cell = screen.cell(row, column)?;
        let foreground = colour(cell.fgcolor(), "#d3d7cf");
        let background = colour(cell.bgcolor(), BACKGROUND);
        let (foreground, background) = if cell.inverse() {
            (background, foreground)
        } else {
            (foreground, background)
        };
        Some((foreground, background, cell.bold(), cell.dim()))
    }

    /// The screen as SVG. A run of cells of one style is one text, fitted to its cells in any font.
    fn to_svg(screen: &vt100::Screen) -> Result<String, std::fmt::Error> {
        let (rows, columns) = screen.size();
        let (rows, columns) = (rows.get(), columns.get());
        let (width, height) = (u32::from(columns) * CELL.0, u32::from(rows) * CELL.1);
        let mut svg = String::new();
        writeln!(
            svg,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\" font-family=\"DejaVu Sans Mono, Liberation Mono, \
             Menlo, Consolas, monospace\" font-size=\"15\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"{BACKGROUND}\"/>"
        )?;
        for row in 0..rows {
            let mut column = 0;
            while column < columns {
                let run_style = style(screen, row, column);
                let start = column;
                let mut text = String::new();
                while column < columns && style(screen, row, column) == run_style {
                    let content = screen.cell(row, column).map_or("", |cell| cell.contents());
                    text.push_str(if content.is_empty() { " " } else { content });
                    column += 1;
                }
                let Some((foreground, background, bold, dim)) = run_style else {
                    continue;
                };
                let (x, y) = (u32::from(start) * CELL.0, u32::from(row) * CELL.1);
                let length = u32::from(column - start) * CELL.0;
                if background != BACKGROUND {
                    writeln!(
                        svg,
                        "<rect x=\"{x}\" y=\"{y}\" width=\"{length}\" height=\"{}\" \
                         fill=\"{background}\"/>",
                        CELL.1
                    )?;
                }
                if text.trim().is_empty() {
                    continue;
                }
                let text = text
                    .replace('&', "&amp;")
                    .replace('<', "&lt;")
                    .replace('>', "&gt;");
                let weight = if bold { " font-weight=\"bold\"" } else { "" };
                let opacity = if dim { " opacity=\"0.65\"" } else { "" };
                writeln!(
                    svg,
                    "<text x=\"{x}\" y=\"{}\" textLength=\"{length}\" \
                     lengthAdjust=\"spacingAndGlyphs\" xml:space=\"preserve\" \
                     fill=\"{foreground}\"{weight}{opacity}>{text}</text>",
                    y + 14
                )?;
            }
        }
        svg.push_str("</svg>\n");
        Ok(svg)
    }

    /// Writes the screen to a file.
    fn picture(terminal: &Terminal, path: &Path) -> Result<(), Box<dyn Error>> {
        std::fs::write(path, terminal.with_screen(to_svg)?)?;
        println!("{}", path.display());
        Ok(())
    }
}
