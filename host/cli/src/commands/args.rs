//! Argument groups that several commands share.

use super::{CliError, Exit};
use clap::Args;
use haptimill_calibration::scenario::errors_of;
use haptimill_client::board::Chosen;
use haptimill_client::port::{DEFAULT_BAUD, PortSpec};
use haptimill_hil_sim::config::PlantConfig;
use haptimill_hil_sim::fault::Fault;
use haptimill_hil_sim::process::CuttingConfig;
use haptimill_machine_file::compensation::CHAIN;
use haptimill_machine_file::{MachineFile, Problem, stock};
use haptimill_teleop::script::Script;
use std::path::{Path, PathBuf};

/// The machine file of a command without a port.
#[derive(Debug, Clone, Args)]
pub struct MachineArg {
    /// Machine file [default: the built-in machines/h4.toml]
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
}

impl MachineArg {
    /// Loads the named machine file, or the built-in one.
    ///
    /// # Errors
    /// Every problem of the file.
    pub fn load(&self) -> Result<MachineFile, CliError> {
        load_machine(self.machine.as_ref())
    }
}

/// The machine file of a command on a port.
#[derive(Debug, Clone, Args)]
pub struct BoardArg {
    /// Machine file [default: the configuration of the board; in the simulator the built-in
    /// machines/h4.toml]
    #[arg(long, value_name = "FILE")]
    pub machine: Option<PathBuf>,
    /// Replace the configuration of a board that is configured as another machine by the one of
    /// --machine; only with the drives off
    #[arg(long, requires = "machine")]
    pub replace_machine: bool,
    /// Geometric errors of the machine, which the controller compensates: an error file as
    /// `haptimill calibrate laser` writes it
    #[arg(long, requires = "machine", value_name = "FILE")]
    pub errors: Option<PathBuf>,
}

impl BoardArg {
    /// Loads the named machine file, or the built-in one.
    ///
    /// # Errors
    /// Every problem of the file.
    pub fn load(&self) -> Result<Chosen, CliError> {
        let machine = load_machine(self.machine.as_ref())?;
        let file = match &self.errors {
            Some(path) => with_errors(&machine, path)?,
            None => machine,
        };
        Ok(Chosen {
            file,
            named: self.machine.is_some(),
            replace: self.replace_machine,
            base: None,
            is_second: false,
        })
    }
}

/// The machine with the errors of a file, which its controller compensates.
///
/// # Errors
/// The file cannot be read, or the controller would refuse its errors.
pub(super) fn with_errors(machine: &MachineFile, path: &Path) -> Result<MachineFile, CliError> {
    let text = haptimill_machine_file::read_text(path)?;
    let name = path.display().to_string();
    let joined = machine.with_errors(&name, &text, CHAIN);
    joined.map_err(|problems| {
        // A mistake in the errors has its place in their own file, not in the joined one.
        let of_errors = |problem: &Problem| problem.key == "compensation.errors";
        match errors_of(machine, &name, &text) {
            Err(error) if problems.0.iter().all(of_errors) => error.into(),
            _ => problems.into(),
        }
    })
}

fn load_machine(path: Option<&PathBuf>) -> Result<MachineFile, CliError> {
    Ok(match path {
        Some(path) => MachineFile::load(path)?,
        None => MachineFile::built_in()?,
    })
}

/// The port of a running controller.
#[derive(Debug, Clone, Args)]
pub struct ConnectArgs {
    /// Controller: a serial port or pseudo-terminal by its path, or tcp:HOST:PORT
    #[arg(long, value_name = "PORT")]
    pub port: PortSpec,
    /// Baud rate of a serial port [default: 115200]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1200..=12_000_000))]
    pub baud: Option<u32>,
    /// Time to wait for the first answer of the controller
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0, value_parser = seconds)]
    pub timeout: f64,
}

/// The port of a controller, or the built-in simulator.
#[derive(Debug, Clone, Args)]
pub struct PortArgs {
    /// Controller: sim (the built-in simulator), a serial port or pseudo-terminal by its path, or
    /// tcp:HOST:PORT; for `run` also pil:mps2 or pil:mps2-m7 (the controller on an emulated
    /// Cortex-M4F or M7, the machine in the simulator), or emu:pico2 (the image of the Raspberry Pi
    /// Pico 2 on an emulated chip, the machine at its pins)
    #[arg(long, value_name = "PORT", default_value = "sim")]
    pub port: PortSpec,
    /// Baud rate of a serial port [default: 115200], and of the simulated link of `run` and
    /// `teleop` [default: no limit]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1200..=12_000_000))]
    pub baud: Option<u32>,
}

impl PortArgs {
    /// Whether the machine is simulated in this process.
    #[must_use]
    pub const fn is_simulated(&self) -> bool {
        matches!(
            self.port,
            PortSpec::Simulator | PortSpec::Emulated(_) | PortSpec::EmulatedPins
        )
    }

    /// Baud rate of the serial port, also where none is given.
    #[must_use]
    pub fn baud_or_default(&self) -> u32 {
        self.baud.unwrap_or(DEFAULT_BAUD)
    }
}

/// Refuses a baud rate for a TCP port.
///
/// # Errors
/// [`Exit::Usage`].
pub(super) fn check_baud(port: &PortSpec, baud: Option<u32>) -> Result<(), CliError> {
    let (PortSpec::Tcp(_), Some(baud)) = (port, baud) else {
        return Ok(());
    };
    let what = format!("--baud {baud} is for a serial port; leave it out with tcp:");
    Err(CliError::new(Exit::Usage, what))
}

/// The simulated machine.
#[derive(Debug, Clone, Default, Args)]
pub struct SimulatorArgs {
    /// Random seed of the simulated machine [default: the one in the machine file]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Inject a fault into the simulated machine, as "joint-jammed joint=NAME at=1.5s"; repeatable.
    /// `haptimill run --help` lists all faults
    #[arg(long, value_name = "FAULT")]
    pub fault: Vec<Fault>,
}

impl SimulatorArgs {
    /// Refuses the options of the simulator for a machine behind a port.
    ///
    /// # Errors
    /// [`Exit::Usage`].
    pub(super) fn check_unused(&self) -> Result<(), CliError> {
        let option = match (self.fault.first(), self.seed) {
            (Some(fault), _) => format!("--fault \"{fault}\""),
            (None, Some(seed)) => format!("--seed {seed}"),
            (None, None) => return Ok(()),
        };
        let what = format!(
            "{option} is for the simulator in this process; leave out --port, or give the option \
             to `haptimill sim serve`"
        );
        Err(CliError::new(Exit::Usage, what))
    }
}

/// The stock on the table of the simulated machine.
#[derive(Debug, Clone, Default, Args)]
pub struct StockArg {
    /// Stock that is clamped on the simulated machine's table after homing: a file like
    /// examples/block.toml. Without it nothing is cut
    #[arg(long, value_name = "FILE")]
    pub stock: Option<PathBuf>,
}

impl StockArg {
    /// Loads the stock, with the cutter of the machine.
    ///
    /// # Errors
    /// Every problem of the file.
    pub fn load(&self, machine: &MachineFile) -> Result<Option<CuttingConfig>, CliError> {
        let Some(path) = &self.stock else {
            return Ok(None);
        };
        let stock = stock::load(path)?;
        let plant: PlantConfig = machine.plant()?;
        Ok(Some(plant.cutting(stock)))
    }

    /// Refuses a stock for a machine behind a port.
    ///
    /// # Errors
    /// [`Exit::Usage`].
    pub(super) fn check_unused(&self) -> Result<(), CliError> {
        let Some(path) = &self.stock else {
            return Ok(());
        };
        let what = format!(
            "--stock {}: a simulated stock is for the simulator in this process; leave it out, \
             and clamp the stock on the table, or give it to `haptimill sim serve`",
            path.display()
        );
        Err(CliError::new(Exit::Usage, what))
    }
}

/// The operator model at a simulated haptic arm.
#[derive(Debug, Clone, Default, Args)]
pub struct OperatorArg {
    /// Operator model at the simulated haptic arm of the machine file: a script as
    /// examples/teleop.toml. It starts when the motors of the arm are on; the commands in it are
    /// ignored
    #[arg(long, value_name = "FILE")]
    pub operator: Option<PathBuf>,
}

impl OperatorArg {
    /// Loads the script of the operator model.
    ///
    /// # Errors
    /// The machine has no simulated arm, or the script has mistakes.
    pub fn load(&self, machine: &MachineFile) -> Result<Option<Script>, CliError> {
        let Some(file) = &self.operator else {
            return Ok(None);
        };
        let plant: PlantConfig = machine.plant()?;
        if plant.operator.is_none() {
            let what = format!(
                "--operator: {}: has no sections [plant.haptic] and [plant.operator]; use \
                 machines/haptic-master.toml, or append machines/haptic-arm.toml",
                machine.file
            );
            return Err(CliError::new(Exit::Usage, what));
        }
        Ok(Some(Script::load(file)?))
    }
}

/// Parses a time in seconds, above 0 and at most an hour.
pub(super) fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value <= 3600.0 => Ok(value),
        _ => Err("write seconds, above 0 and at most 3600".to_string()),
    }
}
