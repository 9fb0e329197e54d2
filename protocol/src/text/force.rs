//! Sentences of force control.

use super::{AxesText, Describe};
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
    fn describe(&self, _: &AxesText<'_>, f: &mut Formatter<'_>) -> Result {
        let bound = self.bound;
        // Forces and gains have 16 fraction bits, lengths and rates 20.
        let (gain, length) = (Decimal(bound, 16), Decimal(bound, 20));
        match self.parameter {
            ForceParameter::SetpointTooSmall => {
                write!(
                    f,
                    "the force setpoint must be {gain} N or more; \
                     to switch force control off take the axis out of it"
                )
            }
            ForceParameter::SetpointTooLarge => write!(
                f,
                "the force setpoint must be {gain} N or less, three quarters of the sensor range"
            ),
            ForceParameter::DampingTooSmall => write!(
                f,
                "K_V must be {gain} N s/mm or more: \
                 below, the loop is unstable with the delay of a spindle revolution"
            ),
            ForceParameter::DampingTooLarge => write!(f, "K_V must be {gain} N s/mm or less"),
            ForceParameter::MassTooSmall => write!(
                f,
                "K_A must be {gain} N s^2/mm or more: \
                 below, K_A is less than K_V of the highest damping level times a control period"
            ),
            ForceParameter::MassTooLarge => write!(
                f,
                "K_A must be {gain} N s^2/mm or less: above, K_A / K_V exceeds 2^18 control periods"
            ),
            ForceParameter::Limit => write!(
                f,
                "the compliance limit must be above 0 and at most {length} mm"
            ),
            ForceParameter::Rate => {
                f.write_str("the maximum rate of the compliant displacement must be above 0")
            }
            ForceParameter::Sensor => f.write_str(
                "a value of the force sensor is out of its range; correct the machine file",
            ),
            ForceParameter::SlowestSpindle => write!(
                f,
                "the slowest spindle speed must be {bound} rev/min or more: \
                 below, a revolution does not fit the window of the peak force"
            ),
            ForceParameter::Axis => {
                f.write_str("this axis has no force loop; x, y and z of the workpiece have one")
            }
            ForceParameter::Busy => {
                f.write_str("the last change of this axis is still in progress; send it again")
            }
        }
    }
}

impl Describe for ForceProblem {
    fn describe(&self, axes: &AxesText<'_>, f: &mut Formatter<'_>) -> Result {
        let name = |component| axes.axis(component);
        match *self {
            Self::Silent => f.write_str(
                "the force sensor delivers no new samples; check its converter and its cable",
            ),
            Self::Overload { component: 3 } => {
                f.write_str("the amplifier of the force sensor is overloaded; reduce the force")
            }
            Self::Overload { component } => {
                write!(
                    f,
                    "the force sensor is saturated in {}; reduce the force",
                    name(component)
                )
            }
            Self::Stuck { component } => write!(
                f,
                "the force sensor repeats one value in {}; check its cable and amplifier",
                name(component)
            ),
            Self::Drift { component, force } => write!(
                f,
                "the force sensor measures {} N in {} without contact at the tool: \
                 its zero has drifted; tare it",
                Decimal(force, 16),
                name(component)
            ),
            Self::Limit { component, force } => write!(
                f,
                "the force on the tool was {} N in {}, beyond its limit; \
                 check spindle, feed and depth of cut",
                Decimal(force, 16),
                name(component)
            ),
            Self::WrongSign { component } => write!(
                f,
                "the force in {} increases while the tool complies with it; \
                 check the sign of the force sensor in the machine file, and its zero for drift",
                name(component)
            ),
            Self::SlowSpindle { rpm } => write!(
                f,
                "the spindle speed is {rpm} rev/min, too low for force control; \
                 raise it, or lower slowest_rpm in the machine file"
            ),
        }
    }
}

impl Describe for TareRefusal {
    fn describe(&self, axes: &AxesText<'_>, f: &mut Formatter<'_>) -> Result {
        let name = |component| axes.axis(component);
        match *self {
            Self::Silent => f.write_str("samples were missing; check converter and cable"),
            Self::Moving { component, spread } => write!(
                f,
                "the signal varied by {spread} codes in {}; stop spindle and table first",
                name(component)
            ),
            Self::Stuck { component } => write!(
                f,
                "the sensor repeats one value in {}; check cable and amplifier",
                name(component)
            ),
            Self::Offset { component } => write!(
                f,
                "less than half of the range would remain in {}; reset the charge amplifier",
                name(component)
            ),
            Self::Interrupted => {
                f.write_str("the machine moved before the tare was complete; tare at standstill")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::force::{ForceParameter, ForceProblem, ForceRefusal};
    use crate::message::{Fault, Refusal};
    use crate::text::{AxesText, AxisKind, AxisText};
    use std::string::ToString;

    #[test]
    fn bounds_and_forces_are_in_their_units() {
        let x = [AxisText {
            name: "x",
            kind: AxisKind::Linear,
        }];
        let axes = AxesText {
            pose: &x,
            ..AxesText::default()
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
