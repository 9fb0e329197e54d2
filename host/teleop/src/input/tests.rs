//! The input devices, with inputs that arrive in pieces.

use super::*;

/// An input that returns its pieces one by one, then would block.
struct Pieces(VecDeque<Vec<u8>>);

impl Read for Pieces {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let piece = self.0.pop_front().ok_or(io::ErrorKind::WouldBlock)?;
        buffer[..piece.len()].copy_from_slice(&piece);
        Ok(piece.len())
    }
}

fn pieces<const N: usize>(pieces: [&[u8]; N]) -> Pieces {
    Pieces(pieces.iter().map(|piece| piece.to_vec()).collect())
}

fn joystick(value: i16, kind: u8, number: u8) -> Vec<u8> {
    let mut record = vec![1, 2, 3, 4];
    record.extend(value.to_le_bytes());
    record.extend([kind, number]);
    record
}

fn event(kind: u16, code: u16, value: i32) -> Vec<u8> {
    let mut event = vec![0; super::space_mouse::EVENT - 8];
    event.extend(kind.to_ne_bytes());
    event.extend(code.to_ne_bytes());
    event.extend(value.to_ne_bytes());
    event
}

/// Samples of a handle over a time, at every control period.
fn samples<D: Device>(
    handle: &mut VirtualHandle<D>,
    from_us: u64,
    to_us: u64,
) -> Vec<MasterSample> {
    (from_us..to_us)
        .step_by(200)
        .filter_map(|now| handle.advance(now).unwrap())
        .collect()
}

/// The length of a step does not depend on the times of the samples.
#[test]
fn a_step_has_its_length_at_irregular_sample_times() {
    for (late, speed) in [(0, 10.0), (1, 10.0), (7, 4.0), (19, 10.0), (45, 25.0)] {
        let keys = Keyboard::new(pieces([b"d", b"d", b"r"]), speed);
        let mut handle = VirtualHandle::new(keys, "keys");
        let (mut now_us, mut random, mut tip) = (0, 1_u64, [0; COMPONENTS]);
        while now_us < 3_000_000 {
            random = random
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            now_us += 5000 + (random >> 33) % (late * 1000 + 1);
            tip = handle
                .advance(now_us)
                .unwrap()
                .map_or(tip, |sample| sample.pose.tip);
        }
        let mm = tip.map(|raw| f64::from(raw) / PER_MM);
        assert!(
            (mm[0] - 0.4).abs() < 1e-5 && (mm[2] - 0.2).abs() < 1e-5,
            "{late} ms: {mm:?}"
        );
    }
}

#[test]
fn a_key_is_a_step_and_the_enabling_switch_times_out() {
    let keys = Keyboard::new(pieces([b"\x1b", b"[", b"C+", b"\x1b[6~f", b"x g q"]), 10.0);
    let mut handle = VirtualHandle::new(keys, "keys");
    let received = samples(&mut handle, 0, 2_000_000);
    let last = received.last().unwrap().pose;
    // 0.2 mm along x, then two steps of 1 mm down.
    let mm = last.tip.map(|raw| f64::from(raw) / PER_MM);
    assert!(
        (mm[0] - 0.2).abs() < 1e-5 && (mm[2] + 2.0).abs() < 1e-5,
        "{mm:?}"
    );
    assert!(!last.enabling_switch && received[5].pose.enabling_switch);
    assert!(
        received
            .iter()
            .all(|sample| sample.pose.rate[2].abs() <= (10.0 * 4096.0) as i32 + 1)
    );
    let commands: Vec<OperatorCommand> = std::iter::from_fn(|| handle.next_command()).collect();
    assert_eq!(
        commands,
        [
            OperatorCommand::Hold,
            OperatorCommand::Resume,
            OperatorCommand::Hold,
            OperatorCommand::End
        ]
    );
    assert_eq!(handle.status(), MasterStatus::Ready);
}

#[test]
fn sticks_move_the_handle_while_the_button_is_pressed() {
    let start = [joystick(0, 0x82, 0), joystick(0, 0x81, 1)].concat();
    let push = [
        joystick(-32767, 2, 1),
        joystick(1, 1, 0),
        joystick(1500, 2, 0),
    ]
    .concat();
    let (one, other) = push.split_at(11);
    let mut handle = VirtualHandle::new(Joystick::new(pieces([&start, one, other]), 20.0), "js");
    let received = samples(&mut handle, 0, 505_000);
    let mm = received
        .last()
        .unwrap()
        .pose
        .tip
        .map(|raw| f64::from(raw) / PER_MM);
    // Forward is +y, at full speed; x is within its dead zone.
    assert!((mm[1] - 10.0).abs() < 0.2 && mm[0] == 0.0, "{mm:?}");
    let release = [joystick(0, 1, 0), joystick(1, 1, 3)].concat();
    handle.device.input = pieces([&release]);
    let released = samples(&mut handle, 505_000, 800_000);
    assert!(
        released
            .iter()
            .all(|sample| !sample.pose.enabling_switch && sample.pose.rate == [0; 3])
    );
    assert_eq!(handle.next_command(), Some(OperatorCommand::Resume));
    // Unplugged: no more samples.
    handle.device.input = pieces([b""]);
    assert_eq!(samples(&mut handle, 800_000, 900_000), []);
    assert!(matches!(handle.status(), MasterStatus::Waiting(why) if why.starts_with("js: ")));
}

#[test]
fn a_relative_deflection_that_is_not_repeated_is_over() {
    let push = [event(1, 0x100, 1), event(2, 2, -350), event(3, 1, 350)].concat();
    let mut handle = VirtualHandle::new(SpaceMouse::new(pieces([&push]), 20.0), "mouse");
    let received = samples(&mut handle, 0, 505_000);
    let mm = received
        .last()
        .unwrap()
        .pose
        .tip
        .map(|raw| f64::from(raw) / PER_MM);
    // Up for a tenth of a second; towards the operator all the time, because that one is absolute.
    assert!(
        (1.8..2.6).contains(&mm[2]) && (mm[1] + 10.0).abs() < 0.2,
        "{mm:?}"
    );
}

#[test]
fn a_missing_device_is_named() {
    let error = open(Path::new("/dev/input/none"), "game controller", "js").unwrap_err();
    assert!(
        error
            .message
            .starts_with("/dev/input/none: no game controller there: "),
        "{error}"
    );
}
