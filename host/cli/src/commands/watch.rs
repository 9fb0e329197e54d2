//! `haptimill watch`: observes a machine that another process commands.

use super::{CliError, Exit};
use crate::commands::interrupt;
use clap::Args;
use haptimill_client::port::{PortError, PortSpec, TcpTransport, Transport as _};
use std::io::Write as _;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Arguments of `haptimill watch`.
#[derive(Debug, Clone, Args)]
#[command(
    about = "Observe a run that another process commands",
    long_about = "Observe a run that another process commands: `haptimill run part.ngc --port PORT \
                  --serve tcp:127.0.0.1:7100` serves any number of observers, and `haptimill watch \
                  --from tcp:127.0.0.1:7100` is one. An observer cannot command the machine. It \
                  ends with the run, or with Ctrl-C. --screen shows state, positions and messages \
                  on the whole terminal. `?` marks the positions of a machine that is \
                  not homed."
)]
pub struct WatchArgs {
    /// The address of --serve, as tcp:HOST:PORT
    #[arg(long, value_name = "ADDRESS")]
    pub from: PortSpec,
    /// Print every report as it comes, one JSON object per line, for a file or another program
    #[arg(long)]
    pub json: bool,
    /// Show state, positions and messages on the whole screen of a terminal; q ends it
    #[cfg(feature = "console")]
    #[arg(long, conflicts_with = "json")]
    pub screen: bool,
}

/// Longest wait between two looks at Ctrl-C.
const POLL: Duration = Duration::from_millis(100);

/// Longest line, bytes.
const LONGEST: usize = 1 << 16;

/// Prints what the commanding process passes on.
///
/// # Errors
/// The address cannot be reached, or requires a token.
pub fn run(args: &WatchArgs) -> Result<(), CliError> {
    let PortSpec::Tcp(address) = &args.from else {
        let what = format!("{}: write tcp:HOST:PORT", args.from);
        return Err(CliError::new(Exit::Usage, what));
    };
    let mut reports = Reports {
        port: TcpTransport::connect(address)?,
        from: args.from.clone(),
        bytes: Vec::new(),
    };
    #[cfg(feature = "console")]
    if args.screen {
        if crate::console::watch::run(&mut reports, &args.from.to_string())? {
            print_line!("the run has ended");
        }
        return Ok(());
    }
    let interrupted = interrupt::flag();
    let mut shown = String::new();
    while !interrupted.load(Ordering::Relaxed) {
        let Some(lines) = reports.next()? else {
            return Ok(());
        };
        for line in lines {
            if args.json {
                print_line!("{line}");
            } else if let Some(text) = describe(&line, &mut shown) {
                print_line!("{text}");
            }
            let _ = std::io::stdout().flush();
        }
    }
    Ok(())
}

/// The reports and events of a run, as lines of JSON.
pub(crate) struct Reports {
    port: TcpTransport,
    from: PortSpec,
    /// Bytes of a line that has not ended.
    bytes: Vec<u8>,
}

impl Reports {
    /// Waits up to [`POLL`], and returns the lines that have come; `None` after the end of the run.
    ///
    /// # Errors
    /// The port fails, or serves something else.
    pub(crate) fn next(&mut self) -> Result<Option<Vec<String>>, CliError> {
        let mut buffer = [0; 4096];
        match self.port.read(&mut buffer, POLL) {
            Ok(count) => self.bytes.extend_from_slice(&buffer[..count]),
            Err(PortError::Gone { .. }) => return Ok(None),
            Err(error) => return Err(error.into()),
        }
        let mut lines = Vec::new();
        while let Some(end) = self.bytes.iter().position(|byte| *byte == b'\n') {
            let line: Vec<u8> = self.bytes.drain(..=end).collect();
            lines.push(String::from_utf8_lossy(&line).trim_end().to_string());
        }
        if self.bytes.len() > LONGEST {
            let what = format!("{}: this is not an address of --serve", self.from);
            return Err(CliError::new(Exit::Port, what));
        }
        Ok(Some(lines))
    }
}

/// A report as a line of text; none for one that equals the last.
fn describe(line: &str, shown: &mut String) -> Option<String> {
    let report: serde_json::Value = serde_json::from_str(line).ok()?;
    if let Some(event) = report["event"].as_str() {
        return Some(event.to_string());
    }
    // With the drives off nothing is commanded.
    let commanded = report["commanded"].as_object();
    let commanded = commanded.filter(|position| !position.is_empty());
    let position = commanded.or(report["measured"].as_object())?;
    let is_referenced = report["homed"] == true;
    let mark = if is_referenced { "" } else { "?" };
    let names = report["coordinates"].as_array()?.iter();
    let coordinates = names.zip(report["units"].as_array()?);
    let position: String = coordinates
        .filter_map(|(name, unit)| {
            let (name, unit) = (name.as_str()?, unit.as_str()?);
            let value = position.get(name)?.as_f64()?;
            Some(format!("  {name} {value:.3}{mark} {unit}"))
        })
        .collect();
    let line = match report["line"].as_u64() {
        Some(line) => format!(", line {line}"),
        None => String::new(),
    };
    let text = format!("{}{line}{position}", report["state"].as_str()?);
    (*shown != text).then(|| {
        shown.clone_from(&text);
        text
    })
}
