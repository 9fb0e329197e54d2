//! Descriptor of a machine: names, kinds, program letters and roles of its coordinates and joints.
//!
//! General code reads a [`Descriptor`]; it contains no index and no name of a machine. Force
//! control uses [`Role::ToolX`] and the other roles of the tool, a part program the letter of a
//! coordinate, a report its name and kind.

use haptimill_protocol::message::MAX_AXES;
pub use haptimill_protocol::text::AxisKind;

/// Role of a pose coordinate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Role {
    /// Position of the tool tip along x of the workpiece.
    ToolX,
    /// Position of the tool tip along y of the workpiece.
    ToolY,
    /// Position of the tool tip along z of the workpiece.
    ToolZ,
    /// Tilt of the tool about y of the base.
    ToolTilt,
    /// Rotation of the workpiece about x of the base; it turns the weight of the workpiece.
    WorkpieceRotation,
    /// Rotation of the workpiece about z of the table that [`Role::WorkpieceRotation`] rotates.
    TableRotation,
    /// No role in force control, teleoperation or reports of the path.
    None,
}

impl Role {
    /// Whether a coordinate may wrap around: force control and masters need bounds of the others.
    #[must_use]
    pub const fn may_wrap(self) -> bool {
        matches!(self, Self::None | Self::TableRotation)
    }
}

/// The roles of the tool tip: x, y, z.
pub const TOOL_TIP: [Role; 3] = [Role::ToolX, Role::ToolY, Role::ToolZ];

/// A pose coordinate of a machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CoordinateDescriptor {
    /// Name in machine files, reports and commands.
    pub name: &'static str,
    /// Linear or rotary.
    pub kind: AxisKind,
    /// Letter in part programs.
    pub letter: char,
    /// Role.
    pub role: Role,
}

impl CoordinateDescriptor {
    /// A coordinate with this name, kind, program letter and role.
    #[must_use]
    pub const fn new(name: &'static str, kind: AxisKind, letter: char, role: Role) -> Self {
        Self {
            name,
            kind,
            letter,
            role,
        }
    }
}

/// A joint of a machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct JointDescriptor {
    /// Name in machine files and reports.
    pub name: &'static str,
    /// Linear or rotary.
    pub kind: AxisKind,
    /// Whether the joint may wrap around although it is no pose coordinate.
    pub may_wrap: bool,
}

impl JointDescriptor {
    /// A joint with this name and kind.
    #[must_use]
    pub const fn new(name: &'static str, kind: AxisKind) -> Self {
        Self {
            name,
            kind,
            may_wrap: false,
        }
    }

    /// The joint, which may wrap around although it is no pose coordinate: the model computes its
    /// angle modulo a turn, and its bounds over a box as an arc from low upwards to high.
    #[must_use]
    pub const fn wrapping(self) -> Self {
        Self {
            may_wrap: true,
            ..self
        }
    }
}

/// Coordinates and joints of a machine, in the order of [`crate::Pose`] and [`crate::Joints`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Descriptor {
    /// Code of the model in machine files.
    pub code: &'static str,
    /// Pose coordinates.
    pub pose: &'static [CoordinateDescriptor],
    /// Joints.
    pub joints: &'static [JointDescriptor],
    /// Reasons of this geometry alone to refuse a pose, by the code of
    /// [`PoseError::Geometry`](crate::PoseError::Geometry).
    pub errors: &'static [GeometryError],
}

/// Reason of one geometry to refuse a pose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GeometryError {
    /// Name in tables and JSON output.
    pub name: &'static str,
    /// Sentence with the remedy.
    pub sentence: &'static str,
}

impl Descriptor {
    /// Index of the coordinate with a role; `None` if the machine has none.
    #[must_use]
    pub fn coordinate(&self, role: Role) -> Option<usize> {
        self.pose.iter().position(|axis| axis.role == role)
    }

    /// Indices of x, y and z of the tool tip, of those that the machine has.
    #[must_use]
    pub fn tool_tip_parts(&self) -> [Option<usize>; 3] {
        TOOL_TIP.map(|role| self.coordinate(role))
    }

    /// Indices of x, y and z of the tool tip; `None` if the machine lacks one of them.
    #[must_use]
    pub fn tool_tip(&self) -> Option<[usize; 3]> {
        let [x, y, z] = self.tool_tip_parts();
        Some([x?, y?, z?])
    }

    /// Whether force control can move the tool: the first coordinates are x, y and z of the tool
    /// tip. Lengths are added to them.
    #[must_use]
    pub fn has_force_axes(&self) -> bool {
        self.tool_tip() == Some([0, 1, 2])
            && self
                .pose
                .iter()
                .take(TOOL_TIP.len())
                .all(|axis| axis.kind == AxisKind::Linear)
    }

    /// Whether each of the coordinates x, y and z of the tool tip is a joint, and they come first.
    /// Error tables by axis need it.
    #[must_use]
    pub fn has_machine_axes(&self) -> bool {
        let joints = self.pose.iter().zip(self.joints).take(TOOL_TIP.len());
        self.has_force_axes()
            && joints
                .into_iter()
                .all(|(pose, joint)| pose.name == joint.name)
    }

    /// Whether a master can move the tool: it has the axes of force control, and the coordinates
    /// behind are the tilt of the tool and the rotation of the workpiece, as far as the machine has
    /// them. Angles are added to these two.
    #[must_use]
    pub fn has_guided_tool(&self) -> bool {
        let directions = [Role::ToolTilt, Role::WorkpieceRotation];
        let behind = self.pose.iter().skip(TOOL_TIP.len()).map(|axis| axis.role);
        self.has_force_axes() && behind.zip(directions).all(|(role, of)| role == of)
    }

    /// Number of pose coordinates, which is also the number of joints; at most [`MAX_AXES`].
    #[must_use]
    pub const fn axes(&self) -> usize {
        assert!(self.pose.len() == self.joints.len() && self.pose.len() <= MAX_AXES);
        self.pose.len()
    }
}

/// The descriptor of a controller without a machine: a haptic arm alone.
pub const NO_MACHINE: Descriptor = Descriptor {
    code: "none",
    pose: &[],
    joints: &[],
    errors: &[],
};

#[cfg(test)]
mod tests {
    use super::*;

    const fn axis(role: Role, kind: AxisKind) -> CoordinateDescriptor {
        CoordinateDescriptor {
            name: "axis",
            kind,
            letter: 'X',
            role,
        }
    }

    const X: CoordinateDescriptor = axis(Role::ToolX, AxisKind::Linear);
    const Y: CoordinateDescriptor = axis(Role::ToolY, AxisKind::Linear);
    const Z: CoordinateDescriptor = axis(Role::ToolZ, AxisKind::Linear);
    const TILT: CoordinateDescriptor = axis(Role::ToolTilt, AxisKind::Rotary);
    const TURN: CoordinateDescriptor = axis(Role::WorkpieceRotation, AxisKind::Rotary);
    const TURNED_Y: CoordinateDescriptor = axis(Role::ToolY, AxisKind::Rotary);
    const OTHER: CoordinateDescriptor = axis(Role::None, AxisKind::Rotary);

    /// Millimetres are never added to a rotary coordinate: a machine whose first coordinates are
    /// not x, y and z of the tool has no guided tool.
    #[test]
    fn a_guided_tool_needs_its_roles_in_place() {
        let machine = |pose: &'static [CoordinateDescriptor]| Descriptor {
            code: "test",
            pose,
            joints: &[],
            errors: &[],
        };
        for pose in [&[X, Y, Z][..], &[X, Y, Z, TILT], &[X, Y, Z, TILT, TURN]] {
            assert!(machine(pose).has_guided_tool(), "{pose:?}");
            assert!(machine(pose).has_force_axes(), "{pose:?}");
        }
        for pose in [&[X, Y, Z, OTHER, OTHER][..], &[X, Y, Z, TURN]] {
            assert!(machine(pose).has_force_axes(), "{pose:?}");
        }
        for pose in [
            &[OTHER, X, Y, Z][..],
            &[X, Z, Y],
            &[X, Y],
            &[X, TURNED_Y, Z],
        ] {
            assert!(!machine(pose).has_force_axes(), "{pose:?}");
        }
        for pose in [
            &[][..],
            &[OTHER, X, Y, Z],
            &[X, Z, Y],
            &[X, Y],
            &[X, Y, OTHER],
            &[X, OTHER, Y, Z],
            &[X, Y, Z, OTHER, OTHER],
            &[X, Y, Z, TURN],
            &[X, Y, Z, TURN, TILT],
            &[X, TURNED_Y, Z],
        ] {
            assert!(!machine(pose).has_guided_tool(), "{pose:?}");
        }
    }

    /// Each coordinate has a letter and a name of its own, and each role is there once.
    #[test]
    fn descriptors_are_unambiguous() {
        for machine in crate::DESCRIPTORS {
            assert!(machine.axes() > 0, "{}", machine.code);
            for (index, axis) in machine.pose.iter().enumerate() {
                assert!("XYZABCUVW".contains(axis.letter), "{axis:?}");
                for other in &machine.pose[..index] {
                    assert!(other.letter != axis.letter, "{axis:?}");
                    assert!(other.name != axis.name, "{axis:?}");
                    assert!(
                        other.role != axis.role || axis.role == Role::None,
                        "{axis:?}"
                    );
                }
            }
            for (index, joint) in machine.joints.iter().enumerate() {
                let others = &machine.joints[..index];
                assert!(
                    others.iter().all(|other| other.name != joint.name),
                    "{joint:?}"
                );
            }
        }
    }
}
