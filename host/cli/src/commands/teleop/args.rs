//! Arguments of `haptimill teleop`.

use super::master::MasterSpec;
use crate::commands::args::{BoardArg, PortArgs, SimulatorArgs, StockArg, check_baud, seconds};
use crate::commands::run::{RecordedPart, recorded_part};
use crate::commands::{CliError, Exit, run};
use clap::Args;
use haptimill_client::board::Chosen;
use haptimill_client::port::{DEFAULT_BAUD, PortSpec};
use haptimill_hil_sim::fault::{Fault, FaultKind};
use haptimill_machine_file::MachineFile;
use haptimill_teleop::script;
use std::path::PathBuf;

const LONG: &str = "\
Teleoperate the machine: the tool follows a master device, and the cutting force is fed back to it.

--master is the master device:
  sim               a simulated haptic arm on a simulated board of its own, with an operator model
                    that runs the script examples/teleop.toml
  script:FILE       the same with another script: trajectory, enabling switch, commands
  PORT              a haptic arm: a serial port or tcp:HOST:PORT with a controller whose machine
                    file has role = \"master\"
  joystick[:PATH]   a game controller (Linux) [/dev/input/js0]; its first button is the enabling
                    switch
  mouse3d:PATH      a 3D mouse (Linux, /dev/input/event*); its first button is the enabling switch
  keyboard          arrows or wasd move x and y, r and f (page up and down) move z, + and - change
                    the step; space holds, g resumes, q ends
The machine is the built-in one in the simulator, or behind --port. With a script and the simulator \
everything runs in virtual time, and every run is bit-identical.

Commands are read from standard input, one per line, unless the master is a script: hold, resume, \
stop, end, reset-master, gp=SCALE. If the newest master pose is older than stale_ms (50), the \
machine decelerates along its path and holds. `resume` continues from the present poses of master \
and tool. Ctrl-C stops.

The command writes to DIR: recording.hmr (`haptimill replay`, `trace`), trace.csv, teleop.csv (every \
report: master, tool, forces) and summary.json; with a simulated arm also master.hmr, the recording \
of its controller.

--stock, --seed and --fault are for the simulated machine.";

/// Arguments of `haptimill teleop`.
#[derive(Debug, Clone, Args)]
#[command(about = "Teleoperate the machine with force feedback", long_about = LONG,
          after_long_help = run::faults_help(),
          after_help = "`haptimill teleop --help` has details and lists the faults.")]
pub struct TeleopArgs {
    /// Master device: sim, script:FILE, the port of a haptic arm, joystick or joystick:PATH,
    /// mouse3d:PATH, keyboard
    #[arg(long, value_name = "MASTER")]
    pub master: MasterSpec,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub machine: BoardArg,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub port: PortArgs,
    /// Machine file of the haptic arm [default: machines/haptic-master.toml, built in]
    #[arg(long, value_name = "FILE")]
    pub master_machine: Option<PathBuf>,
    /// Replace the configuration of the arm's board by the one of --master-machine where the names
    /// differ
    #[arg(long, requires = "master_machine")]
    pub replace_master_machine: bool,
    /// Baud rate of the arm's serial port [default: 115200]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1200..=12_000_000))]
    pub master_baud: Option<u32>,
    /// Coordinates that follow the master, by their names in the machine file
    #[arg(
        long,
        value_name = "COORDINATES",
        value_delimiter = ',',
        default_value = "x,y,z"
    )]
    pub coordinates: Vec<String>,
    /// Position scale G_P: displacement of the tool per displacement of the master, 0.1 to 2
    /// [default: that of the machine file]
    #[arg(long, value_name = "SCALE", value_parser = parse_scale)]
    pub scale: Option<f64>,
    /// Largest age of the newest master pose before the machine holds, ms; must exceed the delay
    /// from the arm to the machine [default: that of the machine file, 50]
    #[arg(long, value_name = "MS", value_parser = clap::value_parser!(u16).range(5..=1000))]
    pub stale: Option<u16>,
    /// End after this time [default: the end of the script, otherwise never]
    #[arg(long = "for", value_name = "SECONDS", value_parser = seconds)]
    pub duration: Option<f64>,
    /// Reports per second of master and machine; a slow serial port transmits fewer
    #[arg(long, value_name = "HZ", default_value_t = 200, value_parser = clap::value_parser!(u32).range(20..=1000))]
    pub rate: u32,
    /// Spindle speed while the tool follows the master, rev/min
    #[arg(long, value_name = "REV/MIN", default_value_t = 0, value_parser = clap::value_parser!(i16).range(-30_000..=30_000), allow_negative_numbers = true)]
    pub spindle: i16,
    /// Maximum speed of a master that keys or sticks move, mm/s
    #[arg(long, value_name = "MM/S", default_value_t = 20.0, value_parser = parse_speed)]
    pub speed: f64,
    /// Delay of the simulated arm's link, each way, ms
    #[arg(long, value_name = "MS", value_parser = clap::value_parser!(u16).range(0..=1000))]
    pub delay: Option<u16>,
    /// Inject a fault into the simulated arm or its link, as "link-cut at=3s for=1s"; repeatable
    #[arg(long, value_name = "FAULT")]
    pub master_fault: Vec<Fault>,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub simulator: SimulatorArgs,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub stock: StockArg,
    /// Folder for the results; created if it does not exist
    #[arg(long, value_name = "DIR", default_value = "teleop.out")]
    pub out: PathBuf,
    /// Write one row of trace.csv every N control periods
    #[arg(long, value_name = "N", default_value_t = 25, value_parser = clap::value_parser!(u32).range(1..))]
    pub trace_every: u32,
    /// What is recorded of machine and arm: all (a simulated session can then be replayed), every=N
    /// (one of N control periods), or last=TIME (as 90s, 10min, 2h)
    #[arg(long, value_name = "PART", default_value = "all", value_parser = recorded_part)]
    pub record: RecordedPart,
    /// Print only the summary as JSON on standard output
    #[arg(long)]
    pub json: bool,
    /// Print no progress
    #[arg(long)]
    pub quiet: bool,
}

/// Parses the position scale.
fn parse_scale(text: &str) -> Result<f64, String> {
    let scale: f64 = text.parse().map_err(|_| "write 0.1 to 2".to_string())?;
    script::scale(scale).map(|_| scale)
}

fn parse_speed(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.1..=200.0).contains(&value) => Ok(value),
        _ => Err("write mm/s, 0.1 to 200".to_string()),
    }
}

impl TeleopArgs {
    /// Refuses options that contradict each other.
    pub(super) fn check(&self) -> Result<(), CliError> {
        let scripted = matches!(self.master, MasterSpec::Script(_));
        let has_arm = scripted || matches!(self.master, MasterSpec::Port(_));
        let port = &self.port.port;
        let emulated = matches!(port, PortSpec::Emulated(_) | PortSpec::EmulatedPins);
        let what = if emulated && !scripted {
            format!(
                "--port {port}: an emulated controller is slower than real time, so no operator can \
                 move it; use --master sim or script:FILE"
            )
        } else if *port == PortSpec::EmulatedPins && self.stock.stock.is_some() {
            "--stock is for --port sim or pil:mps2; leave it out".to_string()
        } else if *port == PortSpec::EmulatedPins
            && (self.simulator.seed.is_some() || !self.simulator.fault.is_empty())
        {
            "--seed and --fault are for --port sim or pil:mps2; leave them out".to_string()
        } else if matches!(
            self.master,
            MasterSpec::Port(PortSpec::Simulator | PortSpec::Emulated(_) | PortSpec::EmulatedPins)
        ) {
            "--master: write sim, or the port of an arm".to_string()
        } else if !scripted && (self.delay.is_some() || !self.master_fault.is_empty()) {
            "--delay and --master-fault are for the simulated arm; use --master sim or script:FILE"
                .to_string()
        } else if !has_arm && (self.master_machine.is_some() || self.master_baud.is_some()) {
            "--master-machine and --master-baud are for a haptic arm; leave them out".to_string()
        } else {
            if !self.port.is_simulated() {
                self.simulator.check_unused()?;
                self.stock.check_unused()?;
            }
            if let MasterSpec::Port(port @ PortSpec::Tcp(_)) = &self.master
                && let Some(baud) = self.master_baud
            {
                let what = format!(
                    "--master-baud {baud} is for a serial port; leave it out with --master {port}"
                );
                return Err(CliError::new(Exit::Usage, what));
            }
            return check_baud(&self.port.port, self.port.baud);
        };
        Err(CliError::new(Exit::Usage, what))
    }

    /// Indices of the pose coordinates that follow the master.
    pub(super) fn followed_coordinates(&self, machine: &MachineFile) -> Result<Vec<u8>, CliError> {
        let names: Vec<&str> = machine.pose.iter().map(|axis| axis.name.as_str()).collect();
        let mut coordinates = Vec::new();
        for coordinate in &self.coordinates {
            let coordinate = coordinate.trim().to_lowercase();
            let found = names
                .iter()
                .position(|name| name.to_lowercase() == coordinate);
            let Some(index) = found else {
                let what = format!(
                    "there is no coordinate '{coordinate}'; this machine has {}",
                    names.join(", ")
                );
                return Err(CliError::new(Exit::Usage, what));
            };
            if !coordinates.contains(&(index as u8)) {
                coordinates.push(index as u8);
            }
        }
        Ok(coordinates)
    }

    /// The machine file of the haptic arm.
    pub(super) fn load_master(&self) -> Result<Chosen, CliError> {
        Ok(Chosen {
            file: match &self.master_machine {
                Some(file) => MachineFile::load(file)?,
                None => MachineFile::built_in_master()?,
            },
            named: self.master_machine.is_some(),
            replace: self.replace_master_machine,
            base: None,
            is_second: true,
        })
    }

    /// Faults of the simulated arm and its link, with the delay of --delay.
    pub(super) fn master_faults(&self) -> Vec<Fault> {
        let delay = self.delay.map(|ms| Fault {
            what: FaultKind::LinkDelay {
                ms: f64::from(ms),
                direction: haptimill_hil_sim::fault::Direction::Both,
            },
            at_s: 0.0,
            for_s: None,
        });
        self.master_fault.iter().cloned().chain(delay).collect()
    }

    /// Time between reports of this size on a port. Reports use at most half of the byte rate.
    pub(super) fn report_interval_us(&self, spec: &PortSpec, baud: Option<u32>, bytes: u32) -> u32 {
        let requested = 1_000_000 / self.rate;
        match spec {
            PortSpec::Serial(_) => {
                let bytes_per_s = baud.unwrap_or(DEFAULT_BAUD) / 10;
                requested.max(2 * bytes * 1000 / (bytes_per_s / 1000).max(1))
            }
            _ => requested,
        }
    }

    /// Prints a message, unless --json or --quiet is given.
    pub(super) fn print_message(&self, text: &str) {
        if !self.json && !self.quiet {
            print_line!("{text}");
        }
    }
}

/// Byte rate of a serial port; 0 is unlimited.
pub(super) fn line_rate(spec: &PortSpec, baud: Option<u32>) -> u32 {
    match spec {
        PortSpec::Serial(_) => baud.unwrap_or(DEFAULT_BAUD) / 10,
        _ => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn position_scale_is_limited() {
        assert_eq!(parse_scale("0.5"), Ok(0.5));
        assert!(parse_scale("3").unwrap_err().ends_with("0.1 to 2"));
        assert!(parse_scale("x").is_err());
    }
}
