//! Walls and workpieces at the tool.

use super::Player;
use crate::fuzz::checks::Cause;
use haptimill_hil_sim::process::{
    Area, Coefficients, CutterConfig, CuttingConfig, ElasticWall, WorkpieceConfig,
};

impl Player {
    /// Puts an elastic wall at the tool, or takes wall and workpiece away.
    pub(super) fn set_wall(&mut self, wall: Option<(u8, f64, f64)>) {
        let truth = self.bench.rig.plant().truth().pose;
        let Some(process) = self.bench.rig.plant_mut().process_mut() else {
            return;
        };
        let wall = wall.map(|(axis, gap, stiffness)| {
            let axis = usize::from(axis);
            let mut point = [truth[0], truth[1], truth[2]];
            let mut normal = [0.0; 3];
            point[axis] -= gap;
            normal[axis] = 1.0;
            ElasticWall {
                point,
                normal,
                stiffness,
                damping: stiffness * 1e-4,
                radius: 0.0,
            }
        });
        if wall.is_some() {
            self.checks.causes.push(Cause::Contact);
        }
        let removed = wall.is_none();
        process.set_wall(wall);
        if removed && process.cutting().is_some() {
            self.unclamp();
        }
    }

    /// Takes the workpiece away; spindle and sensor stay.
    fn unclamp(&mut self) {
        if let Some(process) = self.bench.plant.process() {
            // The sensor is fitted anew, with another zero.
            let _ = self.bench.rig.plant_mut().fit(&process);
            self.checks.causes.push(Cause::SensorNotTared);
        }
    }

    /// Clamps a workpiece in front of the tool.
    pub(super) fn clamp_stock(&mut self) {
        self.checks.causes.push(Cause::Contact);
        let [x, y, z, ..] = self.bench.rig.plant().truth().pose;
        let config = CuttingConfig {
            cutter: CutterConfig {
                coefficients: Coefficients::P2,
                force_scale: 1.0,
                ..CutterConfig::default()
            },
            workpiece: WorkpieceConfig {
                stock: Area {
                    x_min: x - 80.0,
                    x_max: x - 5.0,
                    y_min: y - 30.0,
                    y_max: y + 30.0,
                },
                map: Area {
                    x_min: x - 45.0,
                    x_max: x - 4.0,
                    y_min: y - 8.0,
                    y_max: y + 8.0,
                },
                cell_mm: 0.2,
                top_mm: z + 1.0,
                bottom_mm: z - 20.0,
                ..WorkpieceConfig::default()
            },
        };
        let _ = self.bench.rig.plant_mut().clamp(&config);
    }
}
