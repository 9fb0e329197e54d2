//! Part programs and stocks that are built in.

macro_rules! files {
    ($folder:literal: $($name:literal)*) => {
        &[$((
            concat!($folder, $name),
            include_str!(concat!("../../../", $folder, $name)),
        )),*]
    };
}

/// Part programs and stocks that a definition can name.
const INPUTS: &[(&str, &str)] = files!("examples/":
    "block.toml" "incline.toml"
    "e1-feed-sweep.ngc" "e2-depth-sweep.ngc" "e3-incline-2.ngc" "e3-incline-4.ngc"
    "e5-incline-2.ngc" "e5-incline-4.ngc" "e6-teleop.ngc" "e7-slot.ngc" "e8-teleop.ngc"
    "e9-pocket.ngc" "e10-teleop.ngc" "e11-circle.ngc" "e12-teleop.ngc");

/// Text of a part program or stock; none when it is not built in.
pub(crate) fn input(path: &str) -> Option<&'static str> {
    let found = INPUTS.iter().find(|(name, _)| *name == path);
    found.map(|(_, text)| *text)
}
