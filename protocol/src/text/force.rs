//! Sentences of force control.

use super::{Axes, Describe, Named};
use crate::force::{ForceParameter, ForceProblem, ForceRefusal, TareRefusal};
use core::fmt::{Display, Formatter, Result};

/// A fixed-point number with its count of fraction bits, displayed with three decimals, rounded
/// half up.
struct Decimal(i32, u32);

impl Display for Decimal {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        // Below 2^31 * 1000 + 2^31.
        let thousandths = (i64::from(self.0) * 1000 + (1 << (self.1 - 1))) >> self.1;
        let sign = if thousandths < 0 { "-" } else { "" };
        let size = thousandths.unsigned_abs();
        write!(f, "{sign}{}.{:03}", size / 1000, size % 1000)
    }
}

impl Describe for ForceRefusal {
    fn describe(&self, _: &Axes<'_>, f: &mut Formatter<'_>) -> Result {
        let bound = self.bound;
        // Forces and gains have 16 fraction bits, lengths and rates 20.
        let (gain, length) = (Decimal(bound, 16), Decimal(bound, 20));
        match self.parameter {
            ForceParameter::DesiredTooSmall => {
                write!(
                    f,
                    "the desired force must be {gain} N or more; to switch force control off take the axis out of it"
                )
            }
            ForceParameter::DesiredTooLarge => write!(
                f,
                "the desired force must be {gain} N or less, three quarters of what the sensor shows"
            ),
            ForceParameter::DampingTooSmall => write!(
                f,
                "K_V must be {gain} N s/mm or more: below, the loop is not stable with the delay of a revolution"
            ),
            ForceParameter::DampingTooLarge => write!(f, "K_V must be {gain} N s/mm or less"),
            ForceParameter::MassTooSmall => write!(
                f,
                "K_A must be {gain} N s^2/mm or more: below, the damping that a stiff contact needs cannot be given in a period"
            ),
            ForceParameter::MassTooLarge => write!(
                f,
                "K_A must be {gain} N s^2/mm or less: above, the loop takes longer than 2^18 control periods"
            ),
            ForceParameter::Limit => write!(
                f,
                "the most that the tool yields must be above 0 and at most {length} mm"
            ),
            ForceParameter::Rate => {
                f.write_str("the rate at which the tool yields must be above 0")
            }
            ForceParameter::Sensor => f.write_str(
                "the values of the force sensor make no sense; correct the machine file",
            ),
            ForceParameter::SlowestSpindle => write!(
                f,
                "a revolution does not fit the window of the peak; the slowest spindle must be {bound} rev/min or more"
            ),
            ForceParameter::Axis => {
                f.write_str("there is no such axis under force; there are x, y and z of the work")
            }
            ForceParameter::Busy => {
                f.write_str("the last change of this axis is still being worked out; say it again")
            }
        }
    }
}

impl Describe for ForceProblem {
    fn describe(&self, axes: &Axes<'_>, f: &mut Formatter<'_>) -> Result {
        let name = |component| Named(axes.pose, component);
        match *self {
            Self::Silent => f.write_str(
                "the force sensor gives no new samples; check its converter and its cable",
            ),
            Self::Overload { component: 3 } => {
                f.write_str("the amplifier of the force sensor is overloaded")
            }
            Self::Overload { component } => {
                write!(f, "the force sensor is saturated in {}", name(component))
            }
            Self::Stuck { component } => write!(
                f,
                "the force sensor repeats one value in {}; check its cable and amplifier",
                name(component)
            ),
            Self::Drift { component, force } => write!(
                f,
                "the force sensor shows {} N in {} with nothing at the tool; its zero has wandered, tare it",
                Decimal(force, 16),
                name(component)
            ),
            Self::Limit { component, force } => write!(
                f,
                "the force on the tool was {} N in {}, more than may be; look at spindle, feed and depth of cut",
                Decimal(force, 16),
                name(component)
            ),
            Self::WrongSign { component } => write!(
                f,
                "the force in {} grows when the tool yields to it: the force sensor has the wrong sign there; correct it in the machine file",
                name(component)
            ),
            Self::SlowSpindle { rpm } => write!(
                f,
                "the spindle turns at {rpm} rev/min, too slowly for force control; turn it faster, or lower the slowest speed in the machine file"
            ),
        }
    }
}

impl Describe for TareRefusal {
    fn describe(&self, axes: &Axes<'_>, f: &mut Formatter<'_>) -> Result {
        let name = |component| Named(axes.pose, component);
        match *self {
            Self::Silent => f.write_str("samples were missing; check its converter and its cable"),
            Self::Moving { component, spread } => write!(
                f,
                "it moved by {spread} codes in {}; let spindle and table come to rest",
                name(component)
            ),
            Self::Stuck { component } => write!(
                f,
                "it repeats one value in {}; check its cable and amplifier",
                name(component)
            ),
            Self::Offset { component } => write!(
                f,
                "in {} less than half of its range would be left; reset the charge amplifier",
                name(component)
            ),
            Self::Interrupted => f.write_str("the machine began to move before it was done"),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::force::{ForceParameter, ForceProblem, ForceRefusal};
    use crate::message::{Fault, Refusal};
    use crate::text::{Axes, Axis, AxisKind};
    use std::string::ToString;

    #[test]
    fn bounds_and_forces_are_in_their_units() {
        let x = [Axis {
            name: "x",
            kind: AxisKind::Linear,
        }];
        let axes = Axes {
            pose: &x,
            joints: &[],
        };
        let refusal = Refusal::Force {
            axis: 0,
            refusal: ForceRefusal {
                parameter: ForceParameter::DampingTooSmall,
                bound: 3 << 15,
            },
        };
        assert!(
            axes.describe(&refusal)
                .to_string()
                .starts_with("force loop of x: K_V must be 1.500 N s/mm or more")
        );
        let fault = Fault::Force(ForceProblem::Limit {
            component: 0,
            force: -81 << 16,
        });
        assert!(
            axes.describe(&fault)
                .to_string()
                .starts_with("the force on the tool was -81.000 N in x,")
        );
        assert!(
            fault
                .to_string()
                .starts_with("the force on the tool was -81.000 N in axis 1,")
        );
    }
}
