//! Length of a tool on machines whose tool and workpiece turn against each other: there it is no
//! offset along Z of the workpiece, but a length along the tool.

use super::path::Path;

/// Coordinates that turn tool and workpiece against each other, by their index.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ToolAxis {
    /// x, y and z of the tool tip in the workpiece.
    pub tip: [usize; 3],
    /// Tilt of the tool about y of the base.
    pub tilt: Option<usize>,
    /// Rotation of the workpiece, or of the table that turns it, about x of the base.
    pub rotation: Option<usize>,
    /// Rotation of the workpiece about z of the table.
    pub table: Option<usize>,
}

/// Sine and cosine of an angle, and its rate in radians.
type Turn = ([f64; 2], f64);

impl ToolAxis {
    /// Whether a pose turns the tool in the workpiece.
    #[must_use]
    pub fn turns(&self) -> bool {
        self.tilt.is_some() || self.rotation.is_some()
    }

    /// Returns the same coordinates, with the index that `place` gives each.
    #[must_use]
    pub(crate) fn map(&self, place: impl Fn(usize) -> usize) -> Self {
        Self {
            tip: self.tip.map(&place),
            tilt: self.tilt.map(&place),
            rotation: self.rotation.map(&place),
            table: self.table.map(&place),
        }
    }

    /// Returns the unit vector from the tip towards the spindle in the workpiece, at a pose in mm
    /// and degrees.
    #[must_use]
    pub fn direction<const N: usize>(&self, pose: &[f64; N]) -> [f64; 3] {
        self.direction_and_rate(pose, &[0.0; N]).0
    }

    /// Returns the direction, and its rate for rates of the pose.
    fn direction_and_rate<const N: usize>(
        &self,
        pose: &[f64; N],
        rates: &[f64; N],
    ) -> ([f64; 3], [f64; 3]) {
        let turn = |index: Option<usize>| -> Turn {
            index.map_or(([0.0, 1.0], 0.0), |index| {
                let (sine, cosine) = libm::sincos(pose[index].to_radians());
                ([sine, cosine], rates[index].to_radians())
            })
        };
        let ([sin_tilt, cos_tilt], tilt) = turn(self.tilt);
        let ([sin_rotation, cos_rotation], rotation) = turn(self.rotation);
        let ([sin_table, cos_table], table) = turn(self.table);
        // On the table, then turned back by its rotation.
        let on_table = [sin_tilt, cos_tilt * sin_rotation, cos_tilt * cos_rotation];
        let rate = [
            tilt * cos_tilt,
            rotation * on_table[2] - tilt * sin_tilt * sin_rotation,
            -rotation * on_table[1] - tilt * sin_tilt * cos_rotation,
        ];
        let back = |[x, y, z]: [f64; 3]| {
            [
                cos_table * x + sin_table * y,
                cos_table * y - sin_table * x,
                z,
            ]
        };
        let direction = back(on_table);
        let [x, y, z] = back(rate);
        (
            direction,
            [x + table * direction[1], y - table * direction[0], z],
        )
    }
}

/// A tool that is longer than that of the machine file, on a machine whose tool and workpiece turn
/// against each other. On other machines, and without such a tool, `length` is 0.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ToolLength {
    /// Coordinates of its direction.
    pub axis: ToolAxis,
    /// Length beyond that of the machine file, mm.
    pub length: f64,
}

impl ToolLength {
    /// Returns the pose of the machine for a pose of the tip, mm and degrees: the controller knows
    /// the tool of the machine file.
    #[must_use]
    pub fn machine_pose<const N: usize>(&self, tip: &[f64; N]) -> [f64; N] {
        self.moved(tip, self.length)
    }

    /// Returns the pose of the tip for a pose of the machine.
    #[must_use]
    pub fn tip_pose<const N: usize>(&self, machine: &[f64; N]) -> [f64; N] {
        self.moved(machine, -self.length)
    }

    fn moved<const N: usize>(&self, pose: &[f64; N], length: f64) -> [f64; N] {
        let mut moved = *pose;
        // Also an exact 0: other machines have no such coordinates.
        if length != 0.0 {
            let direction = self.axis.direction(pose);
            for (index, part) in self.axis.tip.into_iter().zip(direction) {
                moved[index] += length * part;
            }
        }
        moved
    }

    /// Returns the rates of the machine for a pose of the tip and its rates.
    #[must_use]
    pub fn machine_rates<const N: usize>(&self, tip: &[f64; N], rates: &[f64; N]) -> [f64; N] {
        let mut machine = *rates;
        if self.length != 0.0 {
            let (_, turning) = self.axis.direction_and_rate(tip, rates);
            for (index, part) in self.axis.tip.into_iter().zip(turning) {
                machine[index] += self.length * part;
            }
        }
        machine
    }

    /// Returns the rates of the tip for a pose of the machine and its rates.
    #[must_use]
    pub fn tip_rates<const N: usize>(&self, machine: &[f64; N], rates: &[f64; N]) -> [f64; N] {
        let shorter = Self {
            length: -self.length,
            ..*self
        };
        shorter.machine_rates(machine, rates)
    }

    /// Returns the largest angle that the tool turns along a path per unit of its length, radians.
    #[must_use]
    pub fn turn_per_length(&self, path: &Path) -> f64 {
        if self.length == 0.0 {
            return 0.0;
        }
        let turns = [self.axis.tilt, self.axis.rotation, self.axis.table];
        let turned = turns.into_iter().flatten();
        let degrees: f64 = turned.map(|k| (path.to[k] - path.from[k]).abs()).sum();
        degrees.to_radians() / path.length
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOOL: ToolLength = ToolLength {
        axis: ToolAxis {
            tip: [0, 1, 2],
            tilt: Some(3),
            rotation: Some(4),
            table: Some(5),
        },
        length: 40.0,
    };

    /// The rates are the derivative of the pose, at many poses.
    #[test]
    fn rates_are_the_derivative_of_the_pose() {
        let rates = [3.0, -2.0, 1.0, 20.0, -35.0, 50.0];
        let h = 1e-6;
        for step in 0..60 {
            let turn = f64::from(step) * 6.0;
            let tip = [1.0, 2.0, 3.0, 0.4 * turn - 70.0, turn, 3.0 * turn];
            let at = |t: f64| {
                TOOL.machine_pose(&std::array::from_fn::<f64, 6, _>(|k| tip[k] + t * rates[k]))
            };
            let (before, after) = (at(-h), at(h));
            for (k, rate) in TOOL.machine_rates(&tip, &rates).into_iter().enumerate() {
                let slope = (after[k] - before[k]) / (2.0 * h);
                assert!((slope - rate).abs() < 1e-6, "{k} at {turn}: {slope} {rate}");
            }
        }
    }

    #[test]
    fn the_tip_is_a_length_away_from_the_pose_of_the_machine() {
        for step in 0..60 {
            let turn = f64::from(step) * 6.0;
            let tip = [1.0, 2.0, 3.0, 0.4 * turn - 70.0, turn, 3.0 * turn];
            let machine = TOOL.machine_pose(&tip);
            let apart: f64 = (0..3).map(|k| (machine[k] - tip[k]).powi(2)).sum();
            assert!((apart.sqrt() - TOOL.length).abs() < 1e-12);
            let back = TOOL.tip_pose(&machine);
            assert!((0..6).all(|k| (back[k] - tip[k]).abs() < 1e-12));
            let rates = [3.0, -2.0, 1.0, 20.0, -35.0, 50.0];
            let back = TOOL.tip_rates(&machine, &TOOL.machine_rates(&tip, &rates));
            assert!((0..6).all(|k| (back[k] - rates[k]).abs() < 1e-12));
        }
        let none = ToolLength::default();
        let tip = [1.0, 2.0, 3.0, 40.0, 50.0, 60.0];
        assert_eq!(none.machine_pose(&tip), tip);
    }
}
