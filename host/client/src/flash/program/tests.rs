//! `probe-rs` and `dfu-util` as scripts in a folder of a test.

use super::{Program, SearchPath, Seen, Writer};
use crate::ErrorKind;
use crate::flash::elf::tests::{chip, image};
use std::fs;
use std::path::PathBuf;

const FAKE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/src/flash/program/fake.sh");
const NO_PROBE: &str = "No debug probes were found.\n";
const PROBE: &str = "The following debug probes were found:\n\
                     [0]: STLink V2-1 -- 0483:374b:0670FF5 (ST-LINK)\n";
const NO_DFU: &str = "dfu-util 0.11\n\nFound Runtime: [0483:df11] ver=0100, alt=0, name=\"x\"\n\
                      Found DFU: [2e8a:0003] ver=2200, alt=0, name=\"@Other\"\n";
const DFU: &str = "dfu-util 0.11\n\n\
    Found DFU: [0483:df11] ver=2200, devnum=5, cfg=1, intf=0, path=\"1-2\", alt=1, \
    name=\"@Option Bytes  /0x1FFFC000/01*016 e\", serial=\"3\"\n\
    Found DFU: [0483:df11] ver=2200, devnum=5, cfg=1, intf=0, path=\"1-2\", alt=0, \
    name=\"@Internal Flash  /0x08000000/04*016Kg,01*064Kg,07*128Kg\", serial=\"3\"\n";

/// A folder of programs.
struct Programs(tempfile::TempDir);

impl Programs {
    /// Programs with the lists of their devices.
    fn new(programs: &[(Program, &str)]) -> Self {
        let own = Self(tempfile::tempdir().unwrap());
        for (program, list) in programs {
            // A link: a script that was just written may still be open in the child of another
            // test, and the system would not start it.
            std::os::unix::fs::symlink(FAKE, own.path(program.name())).unwrap();
            own.file(&format!("{}.list", program.name()), list);
        }
        own
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn file(&self, name: &str, content: impl AsRef<[u8]>) {
        fs::write(self.path(name), content).unwrap();
    }

    fn search(&self, with: Option<Program>) -> Result<Seen, crate::Error> {
        // Folders that are not there are no problem.
        let folders = vec![self.path("none"), self.0.path().to_path_buf()];
        SearchPath(folders).find(with, chip())
    }

    fn writer(&self, with: Option<Program>) -> Writer {
        match self.search(with).unwrap() {
            Seen::Device(writer) => writer,
            Seen::Nothing(reason) => panic!("{reason}"),
        }
    }

    /// Why no program sees a device.
    fn nothing(&self, with: Option<Program>) -> String {
        match self.search(with).unwrap() {
            Seen::Device(writer) => panic!("{writer:?}"),
            Seen::Nothing(reason) => reason,
        }
    }

    fn write(&self, with: Option<Program>) -> Result<(), crate::Error> {
        let (elf, _) = image();
        self.file("own image.elf", &elf);
        let writer = self.writer(with);
        writer.write(&self.path("own image.elf"), &elf, chip(), self.0.path())
    }

    /// The commands so far, each as the words that the program got.
    fn commands(&self) -> Vec<Vec<String>> {
        let text = fs::read_to_string(self.path("arguments")).unwrap();
        let commands = text.trim_end().split("\n\n");
        let words = |command: &str| command.lines().map(str::to_string).collect();
        commands.map(words).collect()
    }
}

#[test]
fn probe_rs_gets_the_elf_file_and_resets_the_chip() {
    let programs = Programs::new(&[(Program::ProbeRs, PROBE), (Program::DfuUtil, DFU)]);
    programs.write(None).unwrap();
    let file = programs.path("own image.elf");
    let file = file.to_str().unwrap();
    assert_eq!(
        programs.commands(),
        [
            &["probe-rs", "list"][..],
            &[
                "probe-rs",
                "download",
                "--chip",
                "STM32F407VG",
                "--verify",
                file
            ],
            &["probe-rs", "reset", "--chip", "STM32F407VG"],
        ]
    );
    let written = fs::read(programs.path("probe-rs.written")).unwrap();
    assert_eq!(written, image().0);
}

#[test]
fn dfu_util_gets_the_load_segments_in_a_file() {
    let programs = Programs::new(&[(Program::ProbeRs, NO_PROBE), (Program::DfuUtil, DFU)]);
    programs.write(None).unwrap();
    let mut commands = programs.commands();
    let file = PathBuf::from(commands[2].pop().unwrap());
    assert_eq!(file, programs.path("image.bin"));
    let place = "0x08000000:leave";
    assert_eq!(
        commands,
        [
            &["probe-rs", "list"][..],
            &["dfu-util", "-l"],
            &["dfu-util", "-a", "0", "-d", "0483:df11", "-s", place, "-D"],
        ]
    );
    let written = fs::read(programs.path("dfu-util.written")).unwrap();
    assert_eq!(written, image().1);
}

#[test]
fn the_named_program_is_the_only_one_that_is_asked() {
    let programs = Programs::new(&[(Program::ProbeRs, PROBE), (Program::DfuUtil, DFU)]);
    let program = |with| programs.writer(with).program;
    assert_eq!(program(Some(Program::DfuUtil)), Program::DfuUtil);
    assert_eq!(programs.commands(), [["dfu-util", "-l"]]);
    assert_eq!(program(Some(Program::ProbeRs)), Program::ProbeRs);
}

#[test]
fn a_missing_program_is_named() {
    let missing = |programs: &Programs, with| {
        let error = programs.search(with).unwrap_err();
        assert_eq!(error.kind, ErrorKind::Port);
        error.message
    };
    let programs = Programs::new(&[]);
    // This file cannot be started.
    programs.file("dfu-util", "text");
    assert_eq!(
        missing(&programs, None),
        "probe-rs is not on the search path (PATH): install it; or: dfu-util is not on the search \
         path (PATH): install it"
    );
    let programs = Programs::new(&[(Program::DfuUtil, DFU)]);
    assert_eq!(
        missing(&programs, Some(Program::ProbeRs)),
        "probe-rs is not on the search path (PATH): install it"
    );
    assert_eq!(programs.writer(None).program, Program::DfuUtil);
}

#[test]
fn no_device_and_several_devices_are_told_apart() {
    let programs = Programs::new(&[(Program::ProbeRs, NO_PROBE), (Program::DfuUtil, NO_DFU)]);
    assert_eq!(
        programs.nothing(None),
        "probe-rs sees no debug probe: connect the ST-LINK of the board; or: dfu-util sees no boot \
         ROM of the chip: connect the USB of the chip, set BOOT0 high, and reset the board for DFU"
    );
    let dfu_only = programs.nothing(Some(Program::DfuUtil));
    assert!(dfu_only.starts_with("dfu-util sees no"), "{dfu_only}");
    let probes = format!("{PROBE}[1]: J-Link -- 1366:1061:1 (J-Link)\n");
    for (program, list) in [
        (Program::ProbeRs, probes),
        (Program::DfuUtil, DFU.repeat(2)),
    ] {
        let several = Programs::new(&[(program, &list)]).search(None).unwrap_err();
        assert_eq!(several.kind, ErrorKind::Port);
        let what = format!("{} sees 2 devices: leave only", program.name());
        assert!(several.message.starts_with(&what), "{several:?}");
    }
}

#[test]
fn a_program_that_cannot_list_its_devices_is_named() {
    let programs = Programs::new(&[(Program::ProbeRs, PROBE)]);
    programs.file("probe-rslist.code", "3");
    assert_eq!(
        programs.nothing(Some(Program::ProbeRs)),
        "`probe-rs list` failed (exit status: 3): probe-rs says why: connect the ST-LINK of the \
         board"
    );
}

#[test]
fn a_program_that_fails_is_named_with_its_exit_code() {
    let fails = |program, list, step: &str| {
        let programs = Programs::new(&[(program, list)]);
        programs.file(&format!("{}{step}.code", program.name()), "74");
        let error = programs.write(None).unwrap_err();
        assert_eq!(error.kind, ErrorKind::Output);
        (error.message, programs.commands().len())
    };
    let (download, commands) = fails(Program::ProbeRs, PROBE, "download");
    assert!(
        download.starts_with("`probe-rs download --chip STM32F407VG --verify "),
        "{download}"
    );
    assert!(
        download.contains("` ended with exit code 74; read what it printed, check the ST-LINK"),
        "{download}"
    );
    assert_eq!(commands, 2, "no reset behind a failed download");
    let (reset, _) = fails(Program::ProbeRs, PROBE, "reset");
    assert!(
        reset.starts_with("`probe-rs reset --chip STM32F407VG` ended with exit code 74; "),
        "{reset}"
    );
    let (dfu, _) = fails(Program::DfuUtil, DFU, "-a");
    assert!(dfu.starts_with("`dfu-util -a 0 -d 0483:df11 "), "{dfu}");
    assert!(
        dfu.contains("` ended with exit code 74; if it printed"),
        "{dfu}"
    );
    assert!(dfu.contains("set BOOT0 high, reset the board"), "{dfu}");
}

#[test]
fn an_image_for_another_chip_is_not_written() {
    let programs = Programs::new(&[(Program::DfuUtil, DFU)]);
    let writer = programs.writer(None);
    let (mut elf, _) = image();
    elf.truncate(100);
    let error = writer.write(&programs.path("own.elf"), &elf, chip(), programs.0.path());
    assert_eq!(error.unwrap_err().kind, ErrorKind::BadInput);
    assert_eq!(programs.commands(), [["dfu-util", "-l"]]);
}
