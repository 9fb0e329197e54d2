//! Cutting model: a ball-end mill, the workpiece that it cuts, and the force between them.
//!
//! All values are in the frame of the table (x_w, y_w, z_w; docs/control.md 1.3), in mm and N. The
//! spindle angle is in turns, clockwise as seen from above. The force is the one **on the tool**,
//! F_w of the experiments; the force on the workpiece is its opposite.
//!
//! # Method
//!
//! The edges are divided into slices (module `cutter`). A slice cuts with the forces of Altintas
//! and Lee (docs/control.md 5.1),
//!
//! ```text
//! dF_r = K_re dS + K_rc h db     dF_t = K_te dS + K_tc h db     dF_a = K_ae dS + K_ac h db
//! ```
//!
//! The chip thickness h is the distance, along the normal of the ball, from the edge to the surface
//! that earlier teeth left. Two stores describe this surface:
//!
//! * The *tooth path* of the last [`PASSES`] tooth periods (module `tooth_path`), because a tooth
//!   feeds less than a cell of any map. With d the travel of the ball's centre since the tooth
//!   before was at this angle and n the normal, h = d.n. For plain feed this is f_t sin(Psi)
//!   sin(kappa) of docs/control.md 5.1. The smallest value of the remembered passes counts.
//! * The *map* ([`Workpiece`]) of everything older. It determines whether there is material, and
//!   reduces the chip where its surface is nearer than the pass before: entry, exit, one-sided
//!   cuts, inclines, second passes.
//!
//! An edge above the map is out of the material; between two nodes the slice is divided in
//! proportion. The comparison allows for the error of the map's cells ([`Workpiece`]), so a second,
//! equal pass over a cut surface removes nothing.
//!
//! The body between the edges lies [`CutterConfig::relief_mm`] behind them. It touches nothing at
//! normal spindle speed and feed. When the spindle does not turn, the tool acts as a blunt ball on
//! an elastic bed: the force grows with the travel, and vanishes when the tool retracts.
//!
//! # Limits
//!
//! * The cutter is rigid and has no run-out.
//! * The cut does not load the spindle, and has no thermal effect.
//! * Chip thickness is linear in the travel up to a quarter of the radius, which is its maximum.
//! * On walls steeper than some 80 degrees the map is unreliable within 1.5 cells. The model looks
//!   ahead by the distance that compensates this (at most 6 cells), so the cut begins and ends that
//!   much early.
//! * The tool moves on a straight line between two calls of [`Cutting::step`]; the force is the one
//!   at its end.
//!
//! A step over a jump of the tool cuts along the straight line between. Callers must use
//! [`Cutting::place`] to put a tool into the material.

use crate::check::PlantError;
use crate::process::chip::{Edge, NO_CHIP, ToolFrame, View, rotated};
use crate::process::config::{CutterConfig, CuttingConfig};
use crate::process::cutter::{Cutter, Node};
use crate::process::removal::MaterialRemoval;
use crate::process::tooth_path::{PASSES, ToothPath};
use crate::process::workpiece::Workpiece;
use crate::vector::{Vector, dot, minus, plus};

/// Number of azimuths at which the contact of the body is evaluated.
const BODY_AZIMUTHS: usize = 24;

/// Pose of the tool in the frame of the table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToolPose {
    /// Tip of the ball, mm.
    pub tip: Vector,
    /// Unit vector from the tip to the spindle (I_w, J_w, K_w).
    pub axis: Vector,
}

impl ToolPose {
    /// Pose of an upright tool.
    pub const fn upright(tip: Vector) -> Self {
        Self {
            tip,
            axis: [0.0, 0.0, 1.0],
        }
    }

    /// Pose of a tool tilted by `tilt` about y over a workpiece rotated by `rotation` about x,
    /// degrees (docs/control.md (3.20)-(3.22)).
    pub fn leaning(tip: Vector, tilt: f64, rotation: f64) -> Self {
        if tilt == 0.0 && rotation == 0.0 {
            return Self::upright(tip);
        }
        let radian = core::f64::consts::PI / 180.0;
        let (sin_tilt, cos_tilt) = libm::sincos(tilt * radian);
        let (sin_turn, cos_turn) = libm::sincos(rotation * radian);
        Self {
            tip,
            axis: [sin_tilt, cos_tilt * sin_turn, cos_tilt * cos_turn],
        }
    }

    /// Centre of a ball of this radius at the tip.
    fn centre(&self, radius: f64) -> Vector {
        [
            self.tip[0] + radius * self.axis[0],
            self.tip[1] + radius * self.axis[1],
            self.tip[2] + radius * self.axis[2],
        ]
    }
}

/// Result of a step of the cut.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Cut {
    /// Force on the tool, N.
    pub force: Vector,
    /// An edge is in the material.
    pub engaged: bool,
    /// The body of the cutter presses on the material.
    pub pressed: bool,
}

/// A cutter and a workpiece.
#[derive(Debug, Clone)]
pub struct Cutting {
    config: CutterConfig,
    cutter: Cutter,
    workpiece: Workpiece,
    path: ToothPath,
    removal: MaterialRemoval,
    centre: Vector,
    /// Spindle angle, turns, 0 to 1: angle of the first tooth's tip from y_w, clockwise.
    angle: f64,
    chips_mm3: f64,
}

impl Cutting {
    /// Creates a tool in the air beside an uncut workpiece.
    ///
    /// # Errors
    /// All problems of the configuration.
    pub fn new(config: &CuttingConfig, pose: &ToolPose) -> Result<Self, Vec<PlantError>> {
        config.check()?;
        let radius = config.cutter.radius_mm;
        let centre = pose.centre(radius);
        Ok(Self {
            cutter: Cutter::new(&config.cutter, config.workpiece.cell_mm),
            workpiece: Workpiece::new(&config.workpiece),
            path: ToothPath::new(centre),
            removal: MaterialRemoval::new(radius, centre),
            centre,
            angle: 0.0,
            chips_mm3: 0.0,
            config: config.cutter.clone(),
        })
    }

    /// Moves the tool to another pose without cutting on the way.
    pub fn place(&mut self, pose: &ToolPose) {
        self.settle();
        self.centre = pose.centre(self.config.radius_mm);
        self.path = ToothPath::new(self.centre);
        self.removal = MaterialRemoval::new(self.config.radius_mm, self.centre);
    }

    /// Removes all material that the tool has passed from the map, including the passes that the
    /// tooth path still holds. Used before the surface is measured. If the cut continues
    /// afterwards, the first few teeth cut slightly less than they should.
    pub fn settle(&mut self) {
        for passed in self.path.remembered() {
            self.removal
                .follow(&mut self.workpiece, passed, passed.centre);
        }
        self.removal.finish(&mut self.workpiece);
        self.path = ToothPath::new(self.centre);
        self.removal = MaterialRemoval::new(self.config.radius_mm, self.centre);
    }

    /// The workpiece. It does not yet include the last few tooth periods; see [`Cutting::settle`].
    pub const fn workpiece(&self) -> &Workpiece {
        &self.workpiece
    }

    /// Configuration of the cutter, with its material.
    pub const fn config(&self) -> &CutterConfig {
        &self.config
    }

    /// Spindle angle, turns, 0 to 1.
    pub const fn angle(&self) -> f64 {
        self.angle
    }

    /// Volume of all chips, mm^3: chip thickness times width times travel of the edge, sampled at
    /// the steps.
    pub const fn chips_mm3(&self) -> f64 {
        self.chips_mm3
    }

    /// Moves the tool on a straight line to `pose` while the spindle makes `turns` (negative
    /// backwards). Callers must call it once per control period.
    pub fn step(&mut self, pose: &ToolPose, turns: f64) -> Cut {
        let from = self.centre;
        let to = pose.centre(self.config.radius_mm);
        self.centre = to;
        let (removal, workpiece) = (&mut self.removal, &mut self.workpiece);
        let pitches = turns * self.config.teeth as f64;
        self.path.advance(pitches, from, to, |passed| {
            removal.follow(workpiece, passed, to)
        });
        let angle = self.angle + turns;
        self.angle = angle - angle.floor();
        // All edges are above the material.
        if to[2] - self.config.radius_mm >= self.workpiece.highest() {
            return Cut::default();
        }
        let view = self.view(ToolFrame::of(pose.axis));
        let (mut force, engaged, volume) = self.edges(&view);
        let pressed = match self.body(&view) {
            Some(push) => {
                force = plus(force, push);
                true
            }
            None => false,
        };
        let scale = self.config.force_scale;
        let force = view.frame.to_table(force.map(|part| part * scale));
        self.chips_mm3 += volume * core::f64::consts::TAU * turns.max(0.0);
        Cut {
            force,
            engaged,
            pressed,
        }
    }

    fn view(&self, frame: ToolFrame) -> View<'_> {
        let radius = self.config.radius_mm;
        let thickest = radius / 4.0;
        let mut passes = [Vector::default(); PASSES];
        let mut count = 0;
        let mut heading = [0.0; 3];
        for pitches in 1..=PASSES {
            let by = minus(self.centre, self.path.ago(pitches));
            let square = dot(by, by);
            // The map alone describes passes at a larger distance than this.
            if square > thickest * thickest {
                continue;
            }
            if pitches == 1 && square > NO_CHIP * NO_CHIP {
                let length = square.sqrt();
                heading = by.map(|part| part / length);
            }
            passes[count] = frame.to_tool(by);
            count += 1;
        }
        let behind = minus(self.centre, self.removal.cut());
        View {
            workpiece: &self.workpiece,
            frame,
            centre: self.centre,
            passes,
            count,
            thickest,
            heading,
            lag: dot(behind, behind).sqrt(),
        }
    }

    /// Nodes from the tip up to the first one that is above all material.
    fn reaching(&self, view: &View<'_>) -> &[Node] {
        let nodes = self.cutter.nodes();
        let upright = view.frame.z[2];
        let lean = (1.0 - upright * upright).max(0.0).sqrt();
        let clearance = view.workpiece.highest() - view.centre[2];
        // The lowest point of a circle rises with the node from the one where kappa equals the
        // tilt.
        let above = nodes.iter().position(|node| {
            node.height * upright - node.radius * lean > clearance && node.sin_kappa >= lean
        });
        &nodes[..above.map_or(nodes.len(), |first| first + 1)]
    }

    /// Force of all edges on the tool in its own frame, whether an edge is in the material, and the
    /// chip volume per radian, mm^3.
    fn edges(&self, view: &View<'_>) -> (Vector, bool, f64) {
        let material = &self.config.coefficients;
        let nodes = self.reaching(view);
        let mut force = [0.0; 3];
        let mut volume = 0.0;
        let mut engaged = false;
        for tooth in 0..self.config.teeth {
            let turns = self.angle + tooth as f64 / self.config.teeth as f64;
            let (sin, cos) = libm::sincos(turns * core::f64::consts::TAU);
            let mut below = Edge::default();
            for (k, node) in nodes.iter().enumerate() {
                // Psi = angle of the tip - psi: the edge lags behind its tip.
                let radial = [
                    sin * node.cos_lag - cos * node.sin_lag,
                    cos * node.cos_lag + sin * node.sin_lag,
                ];
                let touch = view.touch(node, radial, 0.0);
                let mut here = Edge {
                    touch,
                    cuts: touch.chip >= NO_CHIP && touch.depth > 0.0,
                    ..Edge::default()
                };
                if here.cuts {
                    engaged = true;
                    here.arm = touch.chip * node.radius;
                    here.cutting = rotated(
                        node,
                        radial,
                        [material.radial, material.tangential, material.axial],
                        touch.chip,
                    );
                    here.edge = rotated(
                        node,
                        radial,
                        [
                            material.radial_edge,
                            material.tangential_edge,
                            material.axial_edge,
                        ],
                        1.0,
                    );
                }
                if k > 0 && (here.cuts || below.cuts) {
                    let slice = &self.cutter.slices()[k - 1];
                    let (low, high, onset) = below.parts(&here, self.config.edge_onset_mm);
                    let (low_edge, high_edge) =
                        (low * onset * slice.edge, high * onset * slice.edge);
                    let (low, high) = (low * slice.width, high * slice.width);
                    for (i, sum) in force.iter_mut().enumerate() {
                        *sum += low * below.cutting[i]
                            + high * here.cutting[i]
                            + low_edge * below.edge[i]
                            + high_edge * here.edge[i];
                    }
                    volume += low * below.arm + high * here.arm;
                }
                below = here;
            }
        }
        (force, engaged, volume)
    }

    /// Force of the body on the tool in its own frame; `None` if contact is impossible.
    fn body(&self, view: &View<'_>) -> Option<Vector> {
        let relief = self.config.relief_mm;
        if view.count > 0 {
            let by = view.passes[0];
            if dot(by, by) <= relief * relief {
                return None;
            }
        }
        let mut force = [0.0; 3];
        let mut touched = false;
        let step = core::f64::consts::TAU / BODY_AZIMUTHS as f64;
        let nodes = self.reaching(view);
        let slices = self.cutter.slices();
        for azimuth in 0..BODY_AZIMUTHS {
            let (sin, cos) = libm::sincos(azimuth as f64 * step);
            for (k, node) in nodes.iter().enumerate() {
                let touch = view.touch(node, [sin, cos], relief);
                if touch.chip <= 0.0 || touch.depth <= 0.0 {
                    continue;
                }
                touched = true;
                let before = if k > 0 { slices[k - 1].width } else { 0.0 };
                let after = slices.get(k).map_or(0.0, |slice| slice.width);
                let area = 0.5 * (before + after) * node.radius * step;
                let pressure = touch.chip * self.config.body_stiffness;
                let pressure = pressure.min(self.config.body_pressure) * area;
                force[0] -= pressure * node.sin_kappa * sin;
                force[1] -= pressure * node.sin_kappa * cos;
                force[2] += pressure * node.cos_kappa;
            }
        }
        touched.then_some(force)
    }
}
