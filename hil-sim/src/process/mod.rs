//! The process at the tool: spindle, cut, grinding or contact, elastic structure, and force sensor.
//!
//! [`Process::step`] is called once per control period. It takes the tool pose from the joints and
//! returns the force on the tool, which acts during the following period. The structure deflects
//! under the force of the period before; at 200 us its own time constant dominates (see
//! [`crate::process::structure`]).
//!
//! All parts but the spindle are optional. Values are in the frame of the table, and the force is
//! the one on the tool (see [`crate::process::cutting`]).

mod chip;
pub mod config;
pub mod contact;
pub mod cutter;
pub mod cutting;
pub mod grinding;
pub mod metrology;
pub mod removal;
pub mod sensor;
pub mod spindle;
pub mod structure;
pub mod tooth_path;
pub mod workpiece;

pub use config::{Area, Coefficients, CutterConfig, CuttingConfig, SpindleConfig, WorkpieceConfig};
pub use contact::ElasticWall;
pub use cutting::{Cut, Cutting, ToolPose};
pub use grinding::{Grinding, LapConfig};
pub use spindle::Spindle;
pub use tooth_path::PASSES;
pub use workpiece::Workpiece;

use crate::check::PlantError;
use crate::process::sensor::{Sensor, SensorConfig};
use crate::process::structure::{Structure, StructureConfig};
use crate::random::Random;
use crate::vector::{LEVEL, Vector, dot, plus, times};

/// Configuration of the process at the tool.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ProcessConfig {
    /// Spindle.
    pub spindle: SpindleConfig,
    /// Cutter and workpiece.
    pub cutting: Option<CuttingConfig>,
    /// Elastic body beside (or instead of) the workpiece.
    pub wall: Option<ElasticWall>,
    /// Structure; without it the machine is rigid.
    pub structure: Option<StructureConfig>,
    /// Force sensor.
    pub sensor: Option<SensorConfig>,
}

impl ProcessConfig {
    /// Checks the whole configuration.
    ///
    /// # Errors
    /// All problems.
    pub fn check(&self) -> Result<(), Vec<PlantError>> {
        let mut problems = Vec::new();
        let mut gather = |result: Result<(), Vec<PlantError>>| {
            if let Err(more) = result {
                problems.extend(more);
            }
        };
        gather(self.spindle.check());
        gather(self.cutting.as_ref().map_or(Ok(()), CuttingConfig::check));
        gather(self.wall.as_ref().map_or(Ok(()), ElasticWall::check));
        gather(
            self.structure
                .as_ref()
                .map_or(Ok(()), StructureConfig::check),
        );
        gather(self.sensor.as_ref().map_or(Ok(()), SensorConfig::check));
        if problems.is_empty() {
            Ok(())
        } else {
            Err(problems)
        }
    }
}

/// The process at the tool.
#[derive(Debug, Clone)]
pub struct Process {
    period_s: f64,
    spindle: Spindle,
    cutting: Option<Cutting>,
    grinding: Option<Grinding>,
    wall: Option<ElasticWall>,
    structure: Option<Structure>,
    sensor: Option<Sensor>,
    /// Directions of the tool's own axes in the workpiece frame.
    tool_axes: [Vector; 3],
    /// Point of the force, from the tip.
    force_point: Vector,
    tip: Vector,
    cut: Cut,
    force: Vector,
}

/// Result of one control period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProcessResult {
    /// Position of the tip, including the deflection of the structure, mm.
    pub tip: Vector,
    /// Force on the tool, N.
    pub force: Vector,
}

impl Process {
    /// Creates the process around a tool in the air; `period_s` is the control period.
    ///
    /// # Errors
    /// All problems of the configuration.
    pub fn new(
        config: &ProcessConfig,
        period_s: f64,
        pose: &ToolPose,
        random: Random,
    ) -> Result<Self, Vec<PlantError>> {
        config.check()?;
        Ok(Self {
            period_s,
            spindle: Spindle::new(&config.spindle, period_s),
            cutting: match &config.cutting {
                Some(config) => Some(Cutting::new(config, pose)?),
                None => None,
            },
            grinding: None,
            wall: config.wall.clone(),
            structure: config
                .structure
                .as_ref()
                .map(|config| Structure::new(config, period_s)),
            sensor: config
                .sensor
                .as_ref()
                .map(|config| Sensor::new(config, period_s, random)),
            tool_axes: LEVEL,
            force_point: [0.0; 3],
            tip: pose.tip,
            cut: Cut::default(),
            force: [0.0; 3],
        })
    }

    /// Advances by one period, with the tool pose from the joints, the directions of the workpiece
    /// frame and of the force sensor in the machine frame, and the spindle command `rpm` (rev/min).
    pub fn step(
        &mut self,
        pose: &ToolPose,
        [axes, sensor_axes]: &[[Vector; 3]; 2],
        rpm: f64,
    ) -> ProcessResult {
        let mut pose = *pose;
        if let Some(structure) = &self.structure {
            let deflection = axes.map(|axis| dot(axis, structure.deflection()));
            pose.tip = plus(pose.tip, deflection);
        }
        let velocity = core::array::from_fn(|i| (pose.tip[i] - self.tip[i]) / self.period_s);
        self.tip = pose.tip;
        let turns = self.spindle.advance(rpm);
        self.cut = match &mut self.cutting {
            Some(cutting) => cutting.step(&pose, turns),
            None => Cut::default(),
        };
        self.force = self.cut.force;
        self.force_point = [0.0, 0.0, self.force_height()];
        if let Some(grinding) = &mut self.grinding {
            let ground = grinding.step(pose.tip, &self.tool_axes, turns);
            self.force = plus(self.force, ground.force);
            self.force_point = ground.from_tip;
        }
        if let Some(wall) = &self.wall {
            let push = wall.force(&pose, velocity);
            self.force = plus(self.force, push);
        }
        let [x, y, z] = [0, 1, 2].map(|i| times(axes[i], self.force[i]));
        let in_machine = plus(plus(x, y), z);
        if let Some(structure) = &mut self.structure {
            structure.advance(in_machine);
        }
        if let Some(sensor) = &mut self.sensor {
            // Without a conversion there is no rounding.
            let on_tool = if sensor_axes == axes {
                self.force
            } else {
                sensor_axes.map(|axis| dot(axis, in_machine))
            };
            sensor.sample(on_tool, sensor_axes.map(|axis| -axis[2]));
        }
        ProcessResult {
            tip: self.tip,
            force: self.force,
        }
    }

    /// Height above the tip at which the force acts, mm: the centre of the ball.
    pub fn force_height(&self) -> f64 {
        match (&self.cutting, &self.wall) {
            (Some(cutting), _) => cutting.config().radius_mm,
            (None, Some(wall)) => wall.radius,
            (None, None) => 0.0,
        }
    }

    /// Point of the force, from the tip, mm, in the workpiece frame.
    pub const fn force_point(&self) -> Vector {
        self.force_point
    }

    /// Sets the directions of the tool's own axes in the workpiece frame for the next period.
    pub const fn set_tool_axes(&mut self, axes: [Vector; 3]) {
        self.tool_axes = axes;
    }

    /// A stone on a lap; `None` on a machine without one.
    pub const fn grinding(&self) -> Option<&Grinding> {
        self.grinding.as_ref()
    }

    /// A stone on a lap, with mutable access.
    pub const fn grinding_mut(&mut self) -> Option<&mut Grinding> {
        self.grinding.as_mut()
    }

    /// Puts a stone on the tool and a lap under it, or removes both.
    pub fn set_grinding(&mut self, grinding: Option<Grinding>) {
        self.grinding = grinding;
    }

    /// Result of the cut in the last period.
    pub const fn cut(&self) -> &Cut {
        &self.cut
    }

    /// Force on the tool, N, frame of the table.
    pub const fn force(&self) -> Vector {
        self.force
    }

    /// The spindle.
    pub const fn spindle(&self) -> &Spindle {
        &self.spindle
    }

    /// The spindle, with mutable access for fault injection.
    pub const fn spindle_mut(&mut self) -> &mut Spindle {
        &mut self.spindle
    }

    /// Cutter and workpiece.
    pub const fn cutting(&self) -> Option<&Cutting> {
        self.cutting.as_ref()
    }

    /// Cutter and workpiece, with mutable access.
    pub const fn cutting_mut(&mut self) -> Option<&mut Cutting> {
        self.cutting.as_mut()
    }

    /// Clamps a workpiece on the table and replaces the one before. The tool keeps its pose.
    /// Spindle, structure and sensor do not change.
    ///
    /// # Errors
    /// All problems of the configuration.
    pub fn clamp(
        &mut self,
        config: &CuttingConfig,
        pose: &ToolPose,
    ) -> Result<(), Vec<PlantError>> {
        self.cutting = Some(Cutting::new(config, pose)?);
        Ok(())
    }

    /// Sets or removes the elastic body beside the tool.
    pub fn set_wall(&mut self, wall: Option<ElasticWall>) {
        self.wall = wall;
    }

    /// The structure.
    pub const fn structure(&self) -> Option<&Structure> {
        self.structure.as_ref()
    }

    /// The sensor.
    pub const fn sensor(&self) -> Option<&Sensor> {
        self.sensor.as_ref()
    }

    /// The sensor, with mutable access for resets and fault injection.
    pub const fn sensor_mut(&mut self) -> Option<&mut Sensor> {
        self.sensor.as_mut()
    }
}
