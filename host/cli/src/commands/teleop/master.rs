//! `--master`: the master device.

use haptimill_client::port::PortSpec;
use std::path::PathBuf;
use std::str::FromStr;

/// The master device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum MasterSpec {
    /// A simulated haptic arm with the built-in operator script, or one from a file.
    Script(Option<PathBuf>),
    /// A haptic arm behind a port.
    Port(PortSpec),
    /// A game controller.
    Joystick(PathBuf),
    /// A 3D mouse.
    Mouse3d(PathBuf),
    /// The keyboard.
    Keyboard,
}

impl FromStr for MasterSpec {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let path = |text: &str| match text {
            "" => Err("the path is missing".to_string()),
            path => Ok(PathBuf::from(path)),
        };
        match text.split_once(':') {
            None if text == "sim" => Ok(Self::Script(None)),
            None if text == "keyboard" => Ok(Self::Keyboard),
            None if text == "joystick" => Ok(Self::Joystick(PathBuf::from("/dev/input/js0"))),
            None if text == "mouse3d" => Err(
                "write mouse3d:PATH; /dev/input/by-id has the paths by the names of the devices"
                    .to_string(),
            ),
            Some(("script", file)) => path(file).map(|file| Self::Script(Some(file))),
            Some(("joystick", file)) => path(file).map(Self::Joystick),
            Some(("mouse3d", file)) => path(file).map(Self::Mouse3d),
            Some(("pil", _)) => {
                Err("an emulated board is no master; write sim, or the port of an arm".to_string())
            }
            _ => text.parse().map(Self::Port),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn master_devices_are_parsed() {
        let spec = |text: &str| text.parse::<MasterSpec>();
        assert_eq!(spec("sim"), Ok(MasterSpec::Script(None)));
        assert_eq!(
            spec("script:a.toml"),
            Ok(MasterSpec::Script(Some("a.toml".into())))
        );
        assert_eq!(
            spec("joystick"),
            Ok(MasterSpec::Joystick("/dev/input/js0".into()))
        );
        assert_eq!(
            spec("mouse3d:/dev/x"),
            Ok(MasterSpec::Mouse3d("/dev/x".into()))
        );
        assert_eq!(
            spec("tcp:localhost:7001"),
            Ok(MasterSpec::Port(PortSpec::Tcp(
                "localhost:7001".to_string()
            )))
        );
        assert!(matches!(
            spec("/dev/ttyACM1"),
            Ok(MasterSpec::Port(PortSpec::Serial(_)))
        ));
        assert!(spec("mouse3d").is_err() && spec("script:").is_err() && spec("pil:mps2").is_err());
    }
}
