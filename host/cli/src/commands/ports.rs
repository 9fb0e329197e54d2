//! `haptimill ports`: lists the serial ports, and boards in boot mode.

use super::CliError;
use clap::Args;
use haptimill_client::flash::Places;
use haptimill_client::port;

/// Arguments of `haptimill ports`.
#[derive(Debug, Clone, Args)]
#[command(about = "List the ports that may have a controller")]
pub struct PortsArgs {
    /// Print JSON: a list of {port, what}; a board in boot mode has no port, but a key `flash`
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
    let waiting = Places::default().boards_in_boot_mode();
    if args.json {
        let mut rows: Vec<_> = rows
            .iter()
            .map(|(port, what)| serde_json::json!({ "port": port, "what": what }))
            .collect();
        rows.extend(waiting.iter().map(|board| {
            serde_json::json!({
                "port": null,
                "what": format!("{} in boot mode", board.title),
                "flash": board.name,
            })
        }));
        print_line!("{}", serde_json::Value::from(rows));
        return Ok(());
    }
    let width = rows.iter().map(|(port, _)| port.len()).max().unwrap_or(0);
    for (port, what) in &rows {
        print_line!("{port:width$}  {what}");
    }
    for board in &waiting {
        print_line!(
            "{} is in boot mode: `haptimill flash {}` writes its image",
            board.title,
            board.name
        );
    }
    if serial == 0 && waiting.is_empty() {
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
