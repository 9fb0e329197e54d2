//! Makes the pictures of docs/console.md: runs the console in a pseudo-terminal, works it with keys, and writes its screen as SVG.
//!
//! `cargo run --release --features console --example console_picture` (after `cargo build --release --features console`), from the root of the workspace.

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
    use super::terminal::{Keyboard, Terminal};
    use std::error::Error;
    use std::fmt::Write as _;
    use std::path::Path;
    use std::time::Duration;

    /// Size of a cell, pixels.
    const CELL: (u32, u32) = (9, 18);

    pub(crate) fn main() -> Result<(), Box<dyn Error>> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        // Examples lie in a folder beside the command.
        let me = std::env::current_exe()?;
        let folder = me.parent().and_then(Path::parent).ok_or("no folder")?;
        let program = folder.join("haptimill");
        let out = std::env::temp_dir();
        let arguments = [
            "console",
            "--out",
            out.to_str().ok_or("not UTF-8")?,
            "--work",
            "examples/block.toml",
            "examples/e7-slot.ngc",
        ];
        let terminal = Terminal::start(&program, &arguments, &root, (80, 24), Keyboard::Plain);
        terminal.state("DISABLED");
        terminal.keys(b"e");
        terminal.state("IDLE");
        terminal.keys(b"h");
        terminal.sees("Home?");
        terminal.keys(b"\r");
        terminal.sees("the work is clamped");
        terminal.keys(b"t");
        terminal.sees("Tare?");
        terminal.keys(b"\r");
        terminal.sees("has a new zero");
        terminal.keys(b"f");
        for _ in 0..20 {
            terminal.keys(b"\x1b[C");
            std::thread::sleep(Duration::from_millis(30));
        }
        picture(&terminal, &root.join("docs/console-jog.svg"))?;
        terminal.state("IDLE");
        // Back to where the program begins, exactly: by a step of 10 mm would be elsewhere, so home again.
        terminal.keys(b"h");
        terminal.sees("Home?");
        terminal.keys(b"\r");
        terminal.state("HOMING");
        terminal.state("IDLE");
        terminal.keys(b"y");
        terminal.sees("Force loop");
        terminal.keys(b"\r");
        terminal.sees("x yields");
        terminal.escape();
        terminal.keys(b"l");
        terminal.sees("REC console-");
        terminal.keys(b"p");
        terminal.sees("Enter checks it");
        terminal.keys(b"\r");
        terminal.sees("The machine moves.");
        std::thread::sleep(Duration::from_millis(600));
        terminal.keys(b"\r");
        terminal.state("RUN");
        std::thread::sleep(Duration::from_secs(9));
        picture(&terminal, &root.join("docs/console-run.svg"))?;
        terminal.keys(b"\x18");
        terminal.state("IDLE");
        terminal.keys(b"l");
        terminal.sees(" rows");
        terminal.keys(b"q\r");
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
