//! `haptimill ports`: lists the serial ports.

use super::CliError;
use clap::Args;
use haptimill_client::port;

/// Arguments of `haptimill ports`.
#[derive(Debug, Clone, Args)]
#[command(about = "List the ports that may have a controller")]
pub struct PortsArgs {
    /// Print JSON: a list of {port, what}
    #[arg(long)]
    pub json: bool,
}

/// Lists the serial ports and the built-in simulator.
///
/// # Errors
/// The operating system cannot list its ports.
pub fn run(args: PortsArgs) -> Result<(), CliError> {
    let mut rows = port::list()?;
    let serial = rows.len();
    rows.push(("sim".into(), "the built-in simulator (for `run`)".into()));
    if args.json {
        let rows: Vec<_> = rows
            .iter()
            .map(|(port, what)| serde_json::json!({ "port": port, "what": what }))
            .collect();
        print_line!("{}", serde_json::Value::from(rows));
        return Ok(());
    }
    let width = rows.iter().map(|(port, _)| port.len()).max().unwrap_or(0);
    for (port, what) in &rows {
        print_line!("{port:width$}  {what}");
    }
    if serial == 0 {
        print_line!(
            "\nNo serial port was found. A connected board may need a driver, or the user a \
             permission."
        );
    }
    print_line!(
        "\nNot listed: pseudo-terminals and TCP ports. `haptimill sim serve` opens one and prints \
         its name."
    );
    Ok(())
}
