//! Serial ports and pseudo-terminals.

use super::{PortError, Transport, is_quiet};
use crate::flash::{BOARDS, Board, UsbPort};
use serialport::{ErrorKind, SerialPort, SerialPortInfo, SerialPortType};
use std::io::ErrorKind as IoKind;
use std::time::Duration;

/// Flow control of a serial line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Flow {
    /// None: the receiver must be fast enough.
    None,
    /// The characters XOFF and XON stop and start the sender.
    XonXoff,
    /// The lines RTS and CTS stop and start the sender.
    RtsCts,
}

/// A serial port, locked against other programs.
pub struct SerialTransport {
    name: String,
    port: Box<dyn SerialPort>,
    /// The timeout that is set on the port, to save system calls.
    wait: Duration,
}

impl SerialTransport {
    /// Opens a port with 8 data bits, no parity, 1 stop bit, no flow control. A pseudo-terminal
    /// ignores the baud rate.
    ///
    /// # Errors
    /// [`PortError::Busy`] when another program has locked it, else [`PortError::Open`] with the
    /// remedy.
    pub fn open(path: &str, baud: u32) -> Result<Self, PortError> {
        let wait = Duration::from_millis(10);
        let builder = serialport::new(path, baud).timeout(wait);
        #[cfg(unix)]
        let port = builder.open_native().map(|mut port| {
            // The lock on the file excludes other hosts; TIOCEXCL would exclude a stop as well.
            let _ = port.set_exclusive(false);
            Box::new(port) as Box<dyn SerialPort>
        });
        #[cfg(not(unix))]
        let port = builder.open();
        let port = port.map_err(|error| open_error(path, &error))?;
        Ok(Self {
            name: path.to_string(),
            port,
            wait,
        })
    }

    /// Opens the line of a CAM computer, with flow control.
    ///
    /// # Errors
    /// As [`SerialTransport::open`].
    pub fn open_with_flow(path: &str, baud: u32, flow: Flow) -> Result<Self, PortError> {
        let mut transport = Self::open(path, baud)?;
        let control = match flow {
            Flow::None => serialport::FlowControl::None,
            Flow::XonXoff => serialport::FlowControl::Software,
            Flow::RtsCts => serialport::FlowControl::Hardware,
        };
        transport
            .port
            .set_flow_control(control)
            .map_err(|error| open_error(path, &error))?;
        Ok(transport)
    }

    fn wait(&mut self, wait: Duration) -> Result<(), PortError> {
        if self.wait != wait {
            let result = self.port.set_timeout(wait);
            result.map_err(|error| self.lost(&error.to_string()))?;
            self.wait = wait;
        }
        Ok(())
    }

    fn lost(&self, reason: &str) -> PortError {
        PortError::Gone {
            name: self.name.clone(),
            reason: reason.to_string(),
        }
    }
}

fn open_error(path: &str, error: &serialport::Error) -> PortError {
    let name = path.to_string();
    let text = error.to_string();
    // A lock by TIOCEXCL is EBUSY, one by flock is EWOULDBLOCK; their kinds depend on the platform.
    let locked = ["busy", "lock", "temporarily unavailable"];
    if locked.iter().any(|part| text.to_lowercase().contains(part)) {
        return PortError::Busy { name };
    }
    let remedy = match error.kind() {
        ErrorKind::Io(IoKind::PermissionDenied) => {
            "permission denied: join the group that owns it (`ls -l` shows it, often dialout), then log in again"
        }
        ErrorKind::NoDevice | ErrorKind::Io(IoKind::NotFound) => {
            "`haptimill ports` lists the ports"
        }
        _ => "check that it is a serial port or a pseudo-terminal",
    };
    PortError::Open {
        name,
        reason: text,
        remedy,
    }
}

impl Transport for SerialTransport {
    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> Result<usize, PortError> {
        self.wait(wait)?;
        match self.port.read(buffer) {
            // The serial port of an unplugged board returns end of file.
            Ok(0) if !buffer.is_empty() => Err(self.lost("end of file")),
            Ok(count) => Ok(count),
            Err(error) if is_quiet(&error) => Ok(0),
            Err(error) => Err(self.lost(&error.to_string())),
        }
    }

    fn write(&mut self, bytes: &[u8], wait: Duration) -> Result<usize, PortError> {
        self.wait(wait)?;
        match self.port.write(bytes) {
            Ok(count) => Ok(count),
            Err(error) if is_quiet(&error) => Ok(0),
            Err(error) => Err(self.lost(&error.to_string())),
        }
    }

    fn name(&self) -> &str {
        &self.name
    }
}

/// Serial converters and boards by their USB ids.
fn known(vendor: u16, product: u16) -> Option<&'static str> {
    Some(match (vendor, product) {
        (0x2E8A, 0x000A | 0x0009) => "Raspberry Pi Pico",
        (0x2E8A, 0x000C) => "Raspberry Pi Debug Probe",
        (0x0403, 0x6001) => "serial converter FT232R",
        (0x0403, 0x6014) => "serial converter FT232H",
        (0x0403, 0x6015) => "serial converter FT230X",
        (0x10C4, 0xEA60) => "serial converter CP210x",
        (0x1A86, 0x7523) => "serial converter CH340",
        (0x1A86, 0x55D4) => "serial converter CH9102",
        (0x067B, 0x2303) => "serial converter PL2303",
        (0x0483, 0x374B | 0x374E | 0x3753) => "ST-LINK of a NUCLEO board",
        (0x0483, 0x5740) => "STM32 with a USB serial port",
        _ => return None,
    })
}

/// What a serial port is.
fn describe(kind: &SerialPortType) -> String {
    match kind {
        SerialPortType::UsbPort(usb) => {
            let parts = [&usb.manufacturer, &usb.product, &usb.serial_number];
            let parts: Vec<&str> = parts.into_iter().flatten().map(String::as_str).collect();
            let text = format!("USB {:04x}:{:04x} {}", usb.vid, usb.pid, parts.join(" "));
            let text = text.trim();
            match (board_of_kind(kind), known(usb.vid, usb.pid)) {
                (Some(board), _) => format!("controller on a {} ({text})", board.title),
                (None, Some(name)) => format!("{name} ({text})"),
                (None, None) => text.to_string(),
            }
        }
        SerialPortType::PciPort => "on board".to_string(),
        SerialPortType::BluetoothPort => "Bluetooth".to_string(),
        SerialPortType::Unknown => "serial port".to_string(),
    }
}

/// Whether a serial port is the USB of a board. Other devices have its ids, too: the name counts.
fn is_board(kind: &SerialPortType, board: &Board) -> bool {
    let SerialPortType::UsbPort(usb) = kind else {
        return false;
    };
    let is_own = |own: &UsbPort| {
        (usb.vid, usb.pid) == own.ids && usb.product.as_deref() == Some(own.product)
    };
    board.usb.as_ref().is_some_and(is_own)
}

fn available() -> Result<Vec<SerialPortInfo>, PortError> {
    // The library panics without this folder, for instance in a container.
    if cfg!(target_os = "linux") && !std::path::Path::new("/sys/class/tty").is_dir() {
        return Ok(Vec::new());
    }
    serialport::available_ports().map_err(|error| PortError::Open {
        name: "serial ports".to_string(),
        reason: error.to_string(),
        remedy: "give the port by its path",
    })
}

/// The serial ports of this computer, with their kinds.
///
/// # Errors
/// The system does not list them.
pub fn list() -> Result<Vec<(String, String)>, PortError> {
    let mut ports: Vec<_> = available()?
        .into_iter()
        .map(|port| (port.port_name, describe(&port.port_type)))
        .collect();
    ports.sort();
    Ok(ports)
}

/// The serial ports that are the USB of a board.
///
/// # Errors
/// The system does not list its serial ports.
pub fn list_of(board: &Board) -> Result<Vec<String>, PortError> {
    let ports = available()?.into_iter();
    let mut ports: Vec<String> = ports
        .filter(|port| is_board(&port.port_type, board))
        .map(|port| port.port_name)
        .collect();
    ports.sort();
    Ok(ports)
}

/// The board whose USB a serial port is, also by a link to its path. `None` for other ports, and
/// where the system does not list its ports.
#[must_use]
pub fn board_of(path: &str) -> Option<&'static Board> {
    let real = |path: &str| std::fs::canonicalize(path).unwrap_or_else(|_| path.into());
    let port = real(path);
    let found = available().ok()?.into_iter();
    let kinds = found.filter(|known| real(&known.port_name) == port);
    let mut boards = kinds.filter_map(|known| board_of_kind(&known.port_type));
    boards.next()
}

fn board_of_kind(kind: &SerialPortType) -> Option<&'static Board> {
    BOARDS.iter().find(|board| is_board(kind, board))
}

#[cfg(test)]
mod tests {
    use super::{BOARDS, describe, is_board};
    use serialport::{SerialPortType, UsbPortInfo};

    fn port(vid: u16, pid: u16, product: Option<&str>) -> SerialPortType {
        SerialPortType::UsbPort(UsbPortInfo {
            vid,
            pid,
            serial_number: Some("0123456789ABCDEF".to_string()),
            manufacturer: None,
            product: product.map(str::to_string),
        })
    }

    #[test]
    fn a_board_is_told_from_others_by_its_name() {
        let own = port(0x2E8A, 0x0009, Some("Haptimill Pico 2"));
        assert!(is_board(&own, &BOARDS[0]));
        assert_eq!(
            describe(&own),
            "controller on a Raspberry Pi Pico 2 (USB 2e8a:0009 Haptimill Pico 2 0123456789ABCDEF)"
        );
        let other = port(0x2E8A, 0x0009, Some("Pico"));
        assert!(!is_board(&other, &BOARDS[0]));
        assert_eq!(
            describe(&other),
            "Raspberry Pi Pico (USB 2e8a:0009 Pico 0123456789ABCDEF)"
        );
        let unknown = port(0x1234, 0x0009, None);
        assert_eq!(describe(&unknown), "USB 1234:0009 0123456789ABCDEF");
        let converter = describe(&port(0x10C4, 0xEA60, None));
        assert!(converter.starts_with("serial converter CP210x (USB 10c4:ea60"));
    }
}
