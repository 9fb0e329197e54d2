//! The simulated machine in this process, in real time.

use super::sim::TimeSync;
use haptimill_client::Error;
use haptimill_client::port::PortError;
use haptimill_client::session::{self, Line};
use haptimill_firmware::controller::Controller;
use haptimill_hil_sim::fault::Fault;
use haptimill_hil_sim::plant::GroundTruth;
use haptimill_hil_sim::process::{CuttingConfig, Workpiece};
use haptimill_hil_sim::rig::Rig;
use haptimill_machine_file::MachineFile;
use haptimill_teleop::script::{Script, ScriptedOperator};
use std::time::{Duration, Instant};

/// Sleep after an exchange without data from the machine.
const IDLE_SLEEP: Duration = Duration::from_micros(500);

/// See the module documentation.
pub(crate) struct RealTimeSim {
    rig: Rig<Controller>,
    /// Operator model at its haptic arm.
    operator: Option<ScriptedOperator>,
    time_sync: TimeSync,
    started: Instant,
}

impl RealTimeSim {
    /// The machine of a machine file, which runs from now on.
    ///
    /// # Errors
    /// The file has no `[plant]` section, or the machine cannot have one of the faults.
    pub(crate) fn new(
        machine: &MachineFile,
        seed: Option<u64>,
        faults: Vec<Fault>,
        operator: Option<&Script>,
    ) -> Result<Self, Error> {
        Ok(Self {
            rig: session::rig(machine, seed, None, faults)?,
            operator: operator.map(ScriptedOperator::new),
            time_sync: TimeSync::new(u64::from(machine.config.period_us) * 1000),
            started: Instant::now(),
        })
    }
}

impl Line for RealTimeSim {
    fn exchange(&mut self, transmit: &[u8], received: &mut Vec<u8>) -> Result<u64, PortError> {
        if !transmit.is_empty() {
            self.rig.host_write(transmit);
        }
        let real_ns = u64::try_from(self.started.elapsed().as_nanos()).unwrap_or(u64::MAX);
        for _ in 0..self.time_sync.due(real_ns, self.rig.time_ns()) {
            if let Some(operator) = &mut self.operator {
                operator.act(&mut self.rig);
            }
            self.rig.step();
        }
        let before = received.len();
        self.rig.host_read(received);
        if received.len() == before {
            std::thread::sleep(IDLE_SLEEP);
        }
        Ok(self.rig.time_ns() / 1000)
    }

    fn name(&self) -> String {
        "simulator".to_string()
    }

    /// The session of the console begins with a closed line.
    fn open(&mut self) -> Result<Option<u64>, PortError> {
        Ok(Some(self.rig.time_ns() / 1000))
    }

    /// Without the last teeth, which the cut needs.
    fn stock(&mut self) -> Option<&Workpiece> {
        let cutting = self.rig.plant_mut().process_mut()?.cutting_mut()?;
        Some(cutting.workpiece())
    }

    fn clamp(&mut self, stock: &CuttingConfig) -> Result<(), Error> {
        session::clamp(&mut self.rig, stock)
    }

    fn truth(&self) -> Option<&GroundTruth> {
        Some(self.rig.plant().truth())
    }
}
