//! `haptimill serve`: the live view in a browser.

use super::args::{BoardArg, OperatorArg, PortArgs, SimulatorArgs, StockArg, seconds};
use super::{CliError, Exit};
use clap::Args;
use haptimill_client::port::Token;
use std::net::SocketAddr;
use std::path::PathBuf;

const LONG: &str = "\
Serve a page with the live view of the machine: state, positions, feed, messages, the programmed \
and the executed path in 3D; jog, home, run, hold, resume, stop. Several viewers see the same \
state; one of them commands. The command prints the address of the page.

A jog lasts while its button is held. It ends --jog-timeout milliseconds after the last message of \
the page: also when the connection drops. A running program continues without viewers.

On a loopback address (127.0.0.1, the default) every user of this computer may open the page. On \
any other address a viewer needs the token, which the printed address has. The connection is not \
encrypted: use ssh -L on a network that is not trusted.

A button of a page is no emergency stop of the machine. Ctrl-C stops the machine and ends the \
command.";

/// Arguments of `haptimill serve`.
#[derive(Debug, Clone, Args)]
#[command(about = "Serve a page with the live view of the machine: watch, jog, run, hold, stop",
          long_about = LONG,
          after_help = "docs/web.md describes the page.")]
pub struct ServeArgs {
    /// Address of the page, IP:PORT; port 0 takes a free one
    #[arg(long, value_name = "IP:PORT", default_value = "127.0.0.1:8765")]
    pub listen: SocketAddr,
    /// Token of the viewers [default: none on a loopback address, else a new one]
    #[arg(long, value_name = "TOKEN")]
    pub token: Option<Token>,
    /// Folder of the part programs; uploads go there
    #[arg(long, value_name = "DIR", default_value = ".")]
    pub programs: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: BoardArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub port: PortArgs,
    /// Time to wait for the first answer of the controller
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0, value_parser = seconds)]
    pub timeout: f64,
    /// Jog timeout: a jog ends this long after the last message of the page
    #[arg(long, value_name = "MS", default_value_t = 200, value_parser = clap::value_parser!(u16).range(100..=1000))]
    pub jog_timeout: u16,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub stock: StockArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub operator: OperatorArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub simulator: SimulatorArgs,
}

/// Serves the live view.
///
/// # Errors
/// See [`Exit`].
pub fn run(args: ServeArgs) -> Result<(), CliError> {
    if !args.programs.is_dir() {
        let what = format!(
            "--programs {}: there is no such folder",
            args.programs.display()
        );
        return Err(CliError::new(Exit::Usage, what));
    }
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "-._~".contains(letter);
    if let Some(token) = &args.token
        && !token.reveal().chars().all(is_plain)
    {
        let what = "--token is part of an address here: write letters, digits and -._~ only";
        return Err(CliError::new(Exit::Usage, what));
    }
    serve(args)
}

#[cfg(feature = "console")]
fn serve(args: ServeArgs) -> Result<(), CliError> {
    crate::console::web::run(args)
}

#[cfg(not(feature = "console"))]
fn serve(_: ServeArgs) -> Result<(), CliError> {
    Err(CliError::new(
        Exit::Usage,
        "this haptimill was built without the feature `console`, which serves the page; \
         build it with: cargo build --release",
    ))
}
