//! `haptimill ports`: where a controller could be.

use super::CliError;
use clap::Args;
use haptimill_client::port;

/// Arguments of `haptimill ports`.
#[derive(Debug, Clone, Args)]
#[command(about = "List the ports where a controller could be")]
pub struct PortsArgs {
    /// Print JSON: a list of {port, what}
    #[arg(long)]
    pub json: bool,
}

/// Lists serial ports, and what there is without one.
///
/// # Errors
/// The system does not tell its ports.
pub fn run(args: PortsArgs) -> Result<(), CliError> {
    let mut rows = port::list()?;
    let serial = rows.len();
    rows.push(("sim".into(), "the built-in simulator (for `run`)".into()));
    if args.json {
        let rows: Vec<_> = rows
            .iter()
            .map(|(port, what)| serde_json::json!({ "port": port, "what": what }))
            .collect();
        tell!("{}", serde_json::Value::from(rows));
        return Ok(());
    }
    let width = rows.iter().map(|(port, _)| port.len()).max().unwrap_or(0);
    for (port, what) in &rows {
        tell!("{port:width$}  {what}");
    }
    if serial == 0 {
        tell!(
            "\nNo serial port was found. A board that is connected may need a driver, or you the right to see it."
        );
    }
    tell!(
        "\nNot listed: pseudo-terminals and TCP ports. `haptimill sim serve` makes one and prints it."
    );
    Ok(())
}
