//! `haptimill override`, `hold`, `resume`: requests to the process that runs a job on a port.
//!
//! A controller has one session, and the process of the job has it. That process takes the requests
//! on a local socket of its user, and does what its own keys do.

use super::{CliError, Exit};
use clap::Args;
use haptimill_client::port::PortSpec;
use serde_json::{Value, json};

/// Where the job runs.
#[derive(Debug, Clone, Args)]
pub struct OperateArgs {
    /// Controller, with the name that `haptimill run --port` of the job has
    #[arg(long, value_name = "PORT")]
    pub port: PortSpec,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `haptimill override`.
#[derive(Debug, Clone, Args)]
#[command(
    about = "Change the overrides of a job that another process runs",
    long_about = "Change the overrides of a job that another process runs: a `run`, `console`, \
                  `serve` or `bridge grbl` of the same user on this computer, with a port. Without a \
                  change the command prints the overrides."
)]
pub struct OverrideArgs {
    /// Feed override, percent of the programmed feed; above 100 as far as the limits of the machine
    /// allow
    #[arg(long, value_name = "PERCENT", value_parser = clap::value_parser!(u8).range(0..=200))]
    pub feed: Option<u8>,
    /// Rapid override, percent of the speed of rapid moves
    #[arg(long, value_name = "PERCENT", value_parser = clap::value_parser!(u8).range(0..=100))]
    pub rapid: Option<u8>,
    /// Spindle override, percent of the programmed speed
    #[arg(long, value_name = "PERCENT", value_parser = clap::value_parser!(u8).range(10..=200))]
    pub spindle: Option<u8>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub job: OperateArgs,
}

/// Changes overrides.
///
/// # Errors
/// No job runs on the port, or it refuses the change.
pub fn set_overrides(args: &OverrideArgs) -> Result<(), CliError> {
    let OverrideArgs {
        feed,
        rapid,
        spindle,
        job,
    } = args;
    let mut request = json!({ "command": "override" });
    for (key, percent) in [("feed", feed), ("rapid", rapid), ("spindle", spindle)] {
        if let Some(percent) = percent {
            request[key] = json!(percent);
        }
    }
    ask(job, &request)
}

/// Holds the job along its path.
///
/// # Errors
/// No job runs on the port.
pub fn hold(args: &OperateArgs) -> Result<(), CliError> {
    ask(args, &json!({ "command": "hold" }))
}

/// Ends a hold or a pause of the job.
///
/// # Errors
/// No job runs on the port, or it is not held.
pub fn resume(args: &OperateArgs) -> Result<(), CliError> {
    ask(args, &json!({ "command": "resume" }))
}

/// Sends a request and prints its answer.
#[cfg(unix)]
fn ask(args: &OperateArgs, request: &Value) -> Result<(), CliError> {
    if matches!(
        args.port,
        PortSpec::Simulator | PortSpec::Emulated(_) | PortSpec::EmulatedPins
    ) {
        return Err(haptimill_client::port::PortError::NoPort.into());
    }
    let answer = haptimill_client::port::ask(&args.port, &request.to_string())?;
    let answer: Value = serde_json::from_str(&answer)
        .map_err(|error| CliError::new(Exit::Internal, format!("{answer}: {error}")))?;
    if let Some(what) = answer["error"].as_str() {
        return Err(CliError::new(Exit::Command, what));
    }
    if args.json {
        print_line!("{answer:#}");
    } else if let Some(what) = answer["done"].as_str() {
        print_line!("{what}");
    }
    Ok(())
}

/// Reports that the requests need a Unix system.
#[cfg(not(unix))]
fn ask(_: &OperateArgs, _: &Value) -> Result<(), CliError> {
    let what = "requests to another process need a Unix system";
    Err(CliError::new(Exit::Usage, what))
}
