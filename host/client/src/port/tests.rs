use super::*;
use haptimill_protocol::link::{HostLink, Timing};
use std::time::Instant;

const WAIT: Duration = Duration::from_millis(20);

/// Reads from one end until `expected` bytes came or two seconds went by; the other end is served
/// meanwhile.
fn collect(from: &mut dyn Transport, other: &mut dyn Transport, expected: usize) -> Vec<u8> {
    let end = Instant::now() + Duration::from_secs(2);
    let mut bytes = Vec::new();
    while bytes.len() < expected && Instant::now() < end {
        let mut buffer = [0; 64];
        let count = from.read(&mut buffer, WAIT).unwrap();
        bytes.extend_from_slice(&buffer[..count]);
        other.read(&mut [0; 1], Duration::ZERO).unwrap();
    }
    bytes
}

/// Every byte value is transferred both ways, unchanged and in order.
fn is_clean(host: &mut dyn Transport, device: &mut dyn Transport) {
    let all: Vec<u8> = (0..=255).collect();
    device.read(&mut [0; 8], WAIT).unwrap();
    assert_eq!(host.write(&all, WAIT).unwrap(), 256);
    let mut received = Vec::new();
    while received.len() < 256 {
        let mut buffer = [0; 64];
        let count = device.read(&mut buffer, Duration::from_secs(2)).unwrap();
        assert!(count > 0, "{} of 256 bytes came", received.len());
        received.extend_from_slice(&buffer[..count]);
    }
    assert_eq!(received, all);
    assert_eq!(device.write(&all, WAIT).unwrap(), 256);
    assert_eq!(collect(host, device, 256), all);
}

/// The Hello of a host, on the line.
fn hello() -> Vec<u8> {
    let mut link = HostLink::new(Timing::default());
    link.open(7, 0);
    let mut bytes = [0; 256];
    let count = link.transmit(0, &mut bytes);
    bytes[..count].to_vec()
}

/// The host sends its Hello and the device reads it.
fn open_session(host: &mut dyn Transport, device: &mut dyn Transport) {
    let hello = hello();
    assert_eq!(host.write(&hello, WAIT).unwrap(), hello.len());
    assert_eq!(collect(device, host, hello.len()), hello);
}

/// Reading nothing takes the timeout, and no longer.
fn is_punctual(host: &mut dyn Transport) {
    let before = Instant::now();
    for _ in 0..50 {
        assert_eq!(host.read(&mut [0; 8], Duration::ZERO).unwrap(), 0);
    }
    assert!(before.elapsed() < Duration::from_millis(200));
    let before = Instant::now();
    assert_eq!(
        host.read(&mut [0; 8], Duration::from_millis(60)).unwrap(),
        0
    );
    let took = before.elapsed();
    assert!(took >= Duration::from_millis(50), "{took:?}");
    assert!(took < Duration::from_secs(2), "{took:?}");
}

#[test]
fn specs_are_read_and_written() {
    for text in [
        "sim",
        "tcp:localhost:7000",
        "tcp:[::1]:7000",
        "/dev/ttyACM0",
        "COM3",
    ] {
        let spec: PortSpec = text.parse().unwrap();
        assert_eq!(spec.to_string(), text);
    }
    for text in [
        "tcp:",
        "tcp:localhost",
        "tcp::7000",
        "tcp:host:seven",
        "tcp:host:70000",
        "",
    ] {
        assert!(text.parse::<PortSpec>().is_err(), "{text}");
    }
}

#[test]
fn tcp_carries_bytes_and_sends_a_second_host_away() {
    let mut device = TcpServer::listen("127.0.0.1:0").unwrap();
    let address = device.address().unwrap().to_string();
    // Without a host nothing is received and nothing is kept.
    assert_eq!(device.read(&mut [0; 8], Duration::ZERO).unwrap(), 0);
    assert_eq!(device.write(b"lost", WAIT).unwrap(), 4);
    let mut host = TcpTransport::connect(&address).unwrap();
    open_session(&mut host, &mut device);
    is_clean(&mut host, &mut device);
    is_punctual(&mut host);

    let mut second = TcpTransport::connect(&address).unwrap();
    second.write(b"let me in", WAIT).unwrap();
    std::thread::sleep(2 * WAIT);
    device.read(&mut [0; 8], Duration::ZERO).unwrap();
    let refused = (0..50).find_map(|_| second.read(&mut [0; 128], WAIT).err());
    assert!(
        matches!(refused, Some(PortError::Busy { .. })),
        "{refused:?}"
    );

    // The first disconnects, another one connects.
    drop(host);
    device.read(&mut [0; 8], WAIT).unwrap();
    let mut third = TcpTransport::connect(&address).unwrap();
    open_session(&mut third, &mut device);
    is_clean(&mut third, &mut device);
    drop(device);
    let end = (0..50).find_map(|_| third.read(&mut [0; 8], WAIT).err());
    assert!(matches!(end, Some(PortError::Gone { .. })), "{end:?}");
}

#[test]
fn garbage_does_not_take_the_place_of_a_host() {
    let mut device = TcpServer::listen("127.0.0.1:0").unwrap();
    let address = device.address().unwrap().to_string();
    let mut garbage: Vec<TcpTransport> = (0..4)
        .map(|_| {
            let mut stranger = TcpTransport::connect(&address).unwrap();
            stranger.write(&[7; 1000], WAIT).unwrap();
            stranger
        })
        .collect();
    for _ in 0..10 {
        assert_eq!(device.read(&mut [0; 64], WAIT).unwrap(), 0);
    }
    let mut host = TcpTransport::connect(&address).unwrap();
    open_session(&mut host, &mut device);
    is_clean(&mut host, &mut device);
    garbage.clear();
}

#[cfg(unix)]
#[test]
fn a_pseudo_terminal_carries_bytes_and_is_locked() {
    let mut device = PtyServer::open().unwrap();
    let path = device.name().to_string();
    let mut host = SerialTransport::open(&path, DEFAULT_BAUD).unwrap();
    is_clean(&mut host, &mut device);
    is_punctual(&mut host);
    let second = SerialTransport::open(&path, DEFAULT_BAUD)
        .map(|_| ())
        .unwrap_err();
    assert!(matches!(second, PortError::Busy { .. }), "{second:?}");
    assert!(
        second.to_string().contains("another program uses it"),
        "{second}"
    );
    drop(host);
    let mut again = SerialTransport::open(&path, DEFAULT_BAUD).unwrap();
    is_clean(&mut again, &mut device);
    drop(device);
    let end = (0..50).find_map(|_| again.read(&mut [0; 8], WAIT).err());
    assert!(matches!(end, Some(PortError::Gone { .. })), "{end:?}");
}

#[test]
fn what_is_not_there_says_what_to_do() {
    let missing = SerialTransport::open("/dev/there-is-no-such-port", 9600).map(|_| ());
    let text = missing.unwrap_err().to_string();
    assert!(text.contains("haptimill ports"), "{text}");
    // A port of the system that nothing listens on: bound, then closed.
    let free = TcpServer::listen("127.0.0.1:0").unwrap().address().unwrap();
    let text = TcpTransport::connect(&free.to_string())
        .map(|_| ())
        .unwrap_err()
        .to_string();
    assert!(text.contains("sim serve"), "{text}");
    assert!(list().is_ok());
    assert!(matches!(
        open(&PortSpec::Simulator, 9600),
        Err(PortError::NoPort)
    ));
}
