//! One cutting edge at a node of the cutter: chip thickness, contact with the material, and cutting
//! force. Units: mm, N.

use crate::process::cutter::Node;
use crate::process::tooth_path::PASSES;
use crate::process::workpiece::Workpiece;
use crate::vector::{Vector, dot};

/// Smallest chip thickness, mm; a thinner chip counts as none.
pub(super) const NO_CHIP: f64 = 1e-9;

/// Axes of the tool in the frame of the table: x and y across the tool, z along it.
#[derive(Debug, Clone, Copy)]
pub(super) struct ToolFrame {
    pub(super) x: Vector,
    pub(super) y: Vector,
    pub(super) z: Vector,
}

impl ToolFrame {
    /// Frame of a tool with this axis. Its x lies above the table's x; for an upright tool it is
    /// the frame of the table.
    pub(super) fn of(axis: Vector) -> Self {
        let across = (axis[1] * axis[1] + axis[2] * axis[2]).sqrt();
        let (j, k) = (axis[1] / across, axis[2] / across);
        Self {
            x: [across, -axis[0] * j, -axis[0] * k],
            y: [0.0, k, -j],
            z: axis,
        }
    }

    #[inline(always)]
    pub(super) fn to_table(self, v: Vector) -> Vector {
        let part = |i: usize| self.x[i] * v[0] + self.y[i] * v[1] + self.z[i] * v[2];
        [part(0), part(1), part(2)]
    }

    pub(super) fn to_tool(self, v: Vector) -> Vector {
        let part = |axis: &Vector| axis[0] * v[0] + axis[1] * v[1] + axis[2] * v[2];
        [part(&self.x), part(&self.y), part(&self.z)]
    }
}

/// State of tool and workpiece in a step, as the edges use it.
pub(super) struct View<'a> {
    pub(super) workpiece: &'a Workpiece,
    pub(super) frame: ToolFrame,
    pub(super) centre: Vector,
    /// Travel of the ball since earlier passes, in the frame of the tool.
    pub(super) passes: [Vector; PASSES],
    /// Number of valid entries of `passes`.
    pub(super) count: usize,
    /// Largest chip thickness, mm.
    pub(super) thickest: f64,
    /// Unit vector of the travel in the frame of the table; 0 without travel.
    pub(super) heading: Vector,
    /// Distance by which the map lags behind the tool, mm.
    pub(super) lag: f64,
}

/// Contact of an edge at a node.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Touch {
    /// Chip thickness, mm; 0 or negative when the earlier passes left no material.
    pub(super) chip: f64,
    /// Depth below the map, mm, minus the map's tolerance; 0 when it was not computed.
    pub(super) depth: f64,
}

impl View<'_> {
    /// Distance along the normal (frame of the tool) to the surface that the remembered passes
    /// left, mm. Returns the first value below [`NO_CHIP`], if there is one.
    #[inline(always)]
    fn left_by_passes(&self, normal: Vector) -> f64 {
        let mut thinnest = self.thickest;
        for by in &self.passes[..self.count] {
            let chip = dot(*by, normal);
            if chip < NO_CHIP {
                return chip;
            }
            thinnest = if chip < thinnest { chip } else { thinnest };
        }
        thinnest
    }

    /// Computes the contact at a node in the direction `radial` from the tool axis, `behind` mm
    /// inside the envelope of the edges.
    #[inline(always)]
    pub(super) fn touch(&self, node: &Node, radial: [f64; 2], behind: f64) -> Touch {
        let normal = [
            node.sin_kappa * radial[0],
            node.sin_kappa * radial[1],
            -node.cos_kappa,
        ];
        let chip = self.left_by_passes(normal) - behind;
        if chip < NO_CHIP {
            return Touch { chip, depth: 0.0 };
        }
        let place = self.frame.to_table([
            node.radius * radial[0],
            node.radius * radial[1],
            node.height,
        ]);
        let normal = self.frame.to_table(normal);
        let ahead = 4.0 * node.tolerance - self.lag;
        let ahead = if ahead > 0.0 { ahead } else { 0.0 };
        let inward = node.tolerance + behind;
        let at =
            |i: usize| self.centre[i] + place[i] + ahead * self.heading[i] - inward * normal[i];
        let (x, y, z) = (at(0), at(1), at(2));
        if z >= self.workpiece.highest() {
            return Touch {
                chip,
                depth: self.workpiece.highest() - z,
            };
        }
        let depth = self.workpiece.height(x, y) - z;
        // Deep in the material the chip has its full thickness. At a wall the map cannot resolve
        // the thickness.
        if depth <= 0.0 || depth > 4.0 * chip {
            return Touch { chip, depth };
        }
        // Far side of the chip: if it is in the air, the surface lies between the two sides.
        let (x, y, z) = (
            x - chip * normal[0],
            y - chip * normal[1],
            z - chip * normal[2],
        );
        let beyond = self.workpiece.height(x, y) - z;
        let chip = if beyond < 0.0 {
            chip * depth / (depth - beyond)
        } else {
            chip
        };
        Touch { chip, depth }
    }
}

/// Force of an edge at a node, per mm.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Edge {
    pub(super) touch: Touch,
    /// The edge has a chip.
    pub(super) cuts: bool,
    /// Chip thickness times radius, mm^2.
    pub(super) arm: f64,
    /// Cutting force per mm of chip width.
    pub(super) cutting: Vector,
    /// Edge force per mm of edge, at its full size.
    pub(super) edge: Vector,
}

impl Edge {
    /// Weights of a slice between two nodes: share with the force at the lower node, share with the
    /// force at the upper node, and factor of the edge force.
    #[inline(always)]
    pub(super) fn parts(&self, upper: &Self, onset: f64) -> (f64, f64, f64) {
        let (inside, outside) = match (self.cuts, upper.cuts) {
            (true, false) => (&self.touch, &upper.touch),
            (false, true) => (&upper.touch, &self.touch),
            _ => return (0.5, 0.5, eased(self.touch.chip, upper.touch.chip, onset)),
        };
        let (share, edge) = if outside.chip < NO_CHIP {
            // The chip ends within the slice. Its mean thickness is half of that at the node, and
            // the edge force acts on the whole length that cuts.
            let share = inside.chip / (inside.chip - outside.chip);
            (0.5 * share, 2.0 * eased(0.0, inside.chip, onset))
        } else {
            // The surface crosses the slice.
            let share = inside.depth / (inside.depth - outside.depth);
            (share, eased(inside.chip, inside.chip, onset))
        };
        if self.cuts {
            (share, 0.0, edge)
        } else {
            (0.0, share, edge)
        }
    }
}

/// Mean factor of the edge force over chips between two thicknesses. The factor rises linearly with
/// the chip thickness up to `onset`.
#[inline(always)]
fn eased(a: f64, b: f64, onset: f64) -> f64 {
    let (low, high) = if a < b { (a, b) } else { (b, a) };
    if low >= onset {
        return 1.0;
    }
    if high - low < 1e-3 * onset {
        return high / onset;
    }
    let sum = |chip: f64| {
        if chip < onset {
            0.5 * chip * chip / onset
        } else {
            chip - 0.5 * onset
        }
    };
    (sum(high) - sum(low)) / (high - low)
}

/// Force on the tool in its frame from radial, tangential and axial parts times `size` (the matrix
/// of docs/control.md 5.1).
#[inline(always)]
pub(super) fn rotated(node: &Node, radial: [f64; 2], parts: Vector, size: f64) -> Vector {
    let [r, t, a] = parts;
    let inward = r * node.sin_kappa + a * node.cos_kappa;
    [
        size * (-inward * radial[0] - t * radial[1]),
        size * (-inward * radial[1] + t * radial[0]),
        size * (r * node.cos_kappa - a * node.sin_kappa),
    ]
}
