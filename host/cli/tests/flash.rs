//! `haptimill flash` with a folder in place of the drive of a boot ROM, and a served simulator in
//! place of the board.
#![cfg(unix)]

use crate::scene;
use scene::{SimServer, TestFolder, haptimill, start};
use std::path::Path;
use std::time::{Duration, Instant};

const INFO: &str = "UF2 Bootloader v1.0\nModel: Raspberry Pi RP2350\nBoard-ID: RP2350\n";

/// A UF2 file of one block for a family of chips.
fn image(family: u32) -> Vec<u8> {
    let mut block = vec![0; 512];
    let words = [
        0x0A32_4655,
        0x9E5D_5157,
        0x2000,
        0x1000_0000,
        256,
        0,
        1,
        family,
    ];
    for (at, word) in words.into_iter().enumerate() {
        block[4 * at..4 * at + 4].copy_from_slice(&u32::to_le_bytes(word));
    }
    block[508..].copy_from_slice(&0x0AB1_6F30_u32.to_le_bytes());
    block
}

/// A folder with an image, and a subfolder that is the drive.
fn folder() -> TestFolder {
    let folder = TestFolder::new();
    std::fs::create_dir(folder.path("drive")).unwrap();
    folder.file("drive/INFO_UF2.TXT", INFO);
    folder.file("own.uf2", image(0xE48B_FF59));
    folder
}

/// Does what the boot ROM does: when the whole image is there, its drive disappears.
fn boot_rom(drive: String, length: u64) -> std::thread::JoinHandle<Vec<u8>> {
    std::thread::spawn(move || {
        let file = Path::new(&drive).join("own.uf2");
        let end = Instant::now() + Duration::from_secs(60);
        while std::fs::metadata(&file).map_or(0, |it| it.len()) < length {
            assert!(Instant::now() < end, "no image arrived");
            std::thread::sleep(Duration::from_millis(5));
        }
        let image = std::fs::read(&file).unwrap();
        std::fs::remove_file(Path::new(&drive).join("INFO_UF2.TXT")).unwrap();
        image
    })
}

#[test]
fn the_image_is_copied_and_the_board_answers() {
    let folder = folder();
    let served = SimServer::on_tcp(&["--unconfigured"]);
    let rom = boot_rom(folder.path("drive"), 512);
    let (image_path, drive) = (folder.path("own.uf2"), folder.path("drive"));
    let arguments = ["flash", "--image", &image_path, "--drive", &drive];
    let done = haptimill(&[&arguments[..], &["--port", &served.port]].concat()).expect_code(0);
    assert_eq!(rom.join().unwrap(), image(0xE48B_FF59));
    assert!(done.out.contains("the board has restarted"), "{done:?}");
    assert!(done.out.contains("the board answers at tcp:"), "{done:?}");
    assert!(done.out.contains("no configuration"), "{done:?}");
}

#[test]
fn json_has_the_answer() {
    let folder = folder();
    let served = SimServer::on_tcp(&[]);
    let rom = boot_rom(folder.path("drive"), 512);
    let (image_path, drive) = (folder.path("own.uf2"), folder.path("drive"));
    let arguments = ["flash", "pico2", "--image", &image_path, "--drive", &drive];
    let more = ["--port", &served.port, "--json"];
    let done = haptimill(&[&arguments[..], &more].concat()).expect_code(0);
    rom.join().unwrap();
    let done = done.json();
    assert_eq!(done["bytes"], 512, "{done:#}");
    assert_eq!(done["answer"]["machine"], "h4", "{done:#}");
}

#[test]
fn without_a_port_the_next_step_is_named() {
    let folder = folder();
    let rom = boot_rom(folder.path("drive"), 512);
    let (image_path, drive) = (folder.path("own.uf2"), folder.path("drive"));
    let arguments = ["flash", "--image", &image_path, "--drive", &drive];
    let done = haptimill(&[&arguments[..], &["--wait", "2"]].concat()).expect_code(0);
    rom.join().unwrap();
    assert!(done.out.contains("its answer was not checked"), "{done:?}");
    assert!(done.out.contains("--baud 1000000"), "{done:?}");
}

/// Each missing step in words, with the exit code of its kind.
#[test]
fn each_missing_step_is_named() {
    let folder = folder();
    folder.file("other.uf2", image(0xE48B_FF56));
    folder.file("text.uf2", "no image");
    let empty = TestFolder::new();
    let (image_path, drive, no_drive) =
        (folder.path("own.uf2"), folder.path("drive"), empty.path(""));
    let other_chip = folder.path("other.uf2");
    let no_image = folder.path("text.uf2");
    let no_file = folder.path("none.uf2");
    let cases: [(&[&str], i32, &str); 6] = [
        (
            &["mps2"],
            2,
            "boards that can be flashed: pico2, pico2-encoders, pico2-spi, stm32",
        ),
        (&["--image", &no_file], 3, "cannot be read"),
        (&["--image", &no_image], 3, "is no UF2 file"),
        (&["--image", &other_chip], 3, "is for another chip"),
        (
            &["--image", &image_path, "--drive", &no_drive],
            3,
            "is not the drive of a board in boot mode",
        ),
        (
            &["--image", &image_path, "--port", "sim"],
            2,
            "a board has a serial port or a TCP port",
        ),
    ];
    for (arguments, code, what) in cases {
        let refused = haptimill(&[&["flash"], arguments].concat()).expect_code(code);
        assert!(refused.err.contains(what), "{what}: {refused:?}");
    }
    // The boot ROM keeps its drive: it did not take the image.
    let arguments = ["flash", "--image", &image_path, "--drive", &drive];
    let kept = haptimill(&[&arguments[..], &["--wait", "0.2"]].concat()).expect_code(9);
    assert!(kept.err.contains("did not restart"), "{kept:?}");
}

/// A machine file that the board cannot drive is refused before the image is written; one with
/// another control period than that of the image, when the board says which it has.
#[test]
fn a_wrong_machine_file_is_refused() {
    let folder = folder();
    let (image_path, drive) = (folder.path("own.uf2"), folder.path("drive"));
    let mill = include_str!("../../../machines/mill3.toml");
    folder.file("clock.toml", mill);
    folder.file(
        "fits.toml",
        mill.replace("ticks_per_us = 84", "ticks_per_us = 75"),
    );
    let other = mill.replace("ticks_per_us = 84", "ticks_per_us = 75");
    let other = other.replacen("period_us = 200", "period_us = 250", 1);
    folder.file(
        "period.toml",
        other.replacen("substep_us = 20", "substep_us = 10", 1),
    );
    let [clock, fits, period] =
        ["clock", "fits", "period"].map(|name| folder.path(&format!("{name}.toml")));
    let arguments = ["flash", "--image", &image_path, "--drive", &drive];
    let refused = haptimill(&[&arguments[..], &["--machine", &clock]].concat()).expect_code(3);
    assert!(
        refused.err.contains("joint x: ticks_per_us = 84"),
        "{refused:?}"
    );
    assert!(!Path::new(&drive).join("own.uf2").exists());
    let served = SimServer::on_tcp(&["--unconfigured"]);
    for (machine, code) in [(&fits, 0), (&period, 3)] {
        folder.file("drive/INFO_UF2.TXT", INFO);
        let rom = boot_rom(folder.path("drive"), 512);
        let more = ["--machine", machine.as_str(), "--port", &served.port];
        let done = haptimill(&[&arguments[..], &more].concat()).expect_code(code);
        rom.join().unwrap();
        let says_period = done
            .err
            .contains("the control period of the board is 200 us");
        assert_eq!(says_period, code == 3, "{done:?}");
        std::fs::remove_file(Path::new(&drive).join("own.uf2")).unwrap();
    }
}

#[test]
fn a_board_that_does_not_answer_is_an_error() {
    let folder = folder();
    let (image_path, drive) = (folder.path("own.uf2"), folder.path("drive"));
    let rom = boot_rom(folder.path("drive"), 512);
    // A port that is taken by nobody.
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = format!("tcp:{}", free.local_addr().unwrap());
    drop(free);
    let arguments = ["flash", "--image", &image_path, "--drive", &drive];
    let more = ["--port", &port, "--wait", "2"];
    let silent = start(&[&arguments[..], &more].concat()).end();
    rom.join().unwrap();
    assert_eq!(silent.code, 5, "{silent:?}");
    assert!(silent.err.contains("the image was written"), "{silent:?}");
}
