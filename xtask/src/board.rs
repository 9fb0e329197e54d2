//! Boards: builds their images and measures their size.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A board whose image can be built.
pub struct Board {
    /// Name on the command line.
    pub name: &'static str,
    /// Folder of its sources.
    folder: &'static str,
    target: &'static str,
    binary: &'static str,
    /// Images other than the product's: name, feature, and additional cargo arguments.
    others: &'static [(&'static str, &'static str, &'static [&'static str])],
    /// Features of the product image that one can choose: `cargo xtask board NAME --FEATURE`.
    pub options: &'static [&'static str],
    /// Any of its product images can log: `cargo xtask board NAME --log`.
    has_log: bool,
    /// Control periods of the images of a release besides the one that a build has without
    /// `--period`, us; empty if the board has one period only.
    pub periods: &'static [&'static str],
    /// Its boot ROM takes UF2 files.
    pub has_uf2: bool,
    /// Largest flash and static RAM of an image, bytes.
    flash: u64,
    ram: u64,
}

/// What one can choose of a product image.
#[derive(Clone, Copy, Default)]
pub struct Variant<'a> {
    /// A feature.
    pub option: Option<&'a str>,
    /// The image logs, too.
    pub log: bool,
    /// The control period, us; the build script of the board knows which there are.
    pub period_us: Option<&'a str>,
}

impl<'a> Variant<'a> {
    /// Reads `--OPTION`, `--log` and `--period US`; `None` for other words.
    pub fn of(words: &[&'a str]) -> Option<Self> {
        let mut variant = Self::default();
        let mut words = words.iter();
        while let Some(word) = words.next() {
            match word.strip_prefix("--")? {
                "period" if variant.period_us.is_none() => {
                    variant.period_us = words.next().copied()
                }
                LOG if !variant.log => variant.log = true,
                option if option != LOG && variant.option.is_none() => {
                    variant.option = Some(option)
                }
                _ => return None,
            }
        }
        Some(variant)
    }

    /// What the names of its files end with.
    pub fn suffix(&self) -> String {
        let options = self.features().map(|option| format!("-{option}"));
        let period = self.period_us.map(|period| format!("-{period}us"));
        options.chain(period).collect()
    }

    /// Features of its image.
    fn features(&self) -> impl Iterator<Item = &'a str> {
        self.option.into_iter().chain(self.log.then_some(LOG))
    }
}

/// The feature of images that log.
const LOG: &str = "log";

/// Optimises the controller and the link for speed.
const FOR_SPEED: [&str; 2] = [
    "profile.release.package.haptimill-firmware.opt-level=2",
    "profile.release.package.haptimill-protocol.opt-level=3",
];

/// All boards.
pub const BOARDS: &[Board] = &[MPS2, PICO2, STM32];

const MPS2: Board = Board {
    name: "mps2",
    folder: "firmware/boards/mps2",
    target: "thumbv7em-none-eabihf",
    binary: "haptimill-mps2",
    others: &[
        // This image exceeds the flash budget of the plain image. Optimised for size it would
        // exceed its control period.
        (
            "haptics",
            "haptics",
            &["--config", FOR_SPEED[0], "--config", FOR_SPEED[1]],
        ),
        ("faults", "faults", &[]),
        ("checks", "checks", &[]),
        ("logging", "defmt", &[]),
    ],
    options: &[],
    has_log: false,
    periods: &[],
    has_uf2: false,
    flash: 256 * 1024,
    ram: 64 * 1024,
};

/// Control periods of the Pico 2 that leave 30 % with three and with five joints at 1,000,000
/// steps/s each, us (docs/hardware/pico2.md).
const THREE_JOINTS_US: &str = "250";
/// With five joints.
pub const FIVE_JOINTS_US: &str = "320";
/// The variable of the environment with the control period of an image.
const PERIOD_VARIABLE: &str = "HAPTIMILL_PERIOD_US";

/// The whole image is copied into the RAM, code and constants too.
const PICO2: Board = Board {
    name: "pico2",
    folder: "firmware/boards/pico2",
    target: "thumbv8m.main-none-eabihf",
    binary: "haptimill-pico2",
    others: &[],
    options: &["uart", "encoders", "spi"],
    has_log: true,
    periods: &[THREE_JOINTS_US, FIVE_JOINTS_US],
    has_uf2: true,
    flash: 384 * 1024,
    ram: 384 * 1024,
};

/// The stack has 64 KiB of its own, which the sections do not contain.
const STM32: Board = Board {
    name: "stm32",
    folder: "firmware/boards/stm32",
    target: "thumbv7em-none-eabihf",
    binary: "haptimill-stm32",
    others: &[],
    options: &[],
    has_log: true,
    periods: &[],
    has_uf2: false,
    flash: 384 * 1024,
    ram: 128 * 1024,
};

/// Debian's toolchain, which includes the sources of the core library.
const DEBIAN_CARGO: &str = "/usr/bin/cargo";
const DEBIAN_RUSTC: &str = "/usr/bin/rustc";
const DEBIAN_SOURCES: &str = "/usr/lib/rustlib/src/rust/library/core";
/// Its Debian packages, and the linker.
pub const DEBIAN_PACKAGES: &[&str] = &["rustc-web", "cargo-web", "rust-web-src", "lld-22"];

/// Toolchain that builds for a target.
pub enum Toolchain {
    /// The toolchain that runs this program; it has the target's core library.
    Rustup,
    /// Debian's toolchain, which builds the core library itself, with this linker.
    Debian(PathBuf),
}

impl Toolchain {
    /// Finds the toolchain for a target; `None` when there is none.
    pub fn find(target: &str) -> Option<Self> {
        let sysroot = Command::new("rustc")
            .args(["--print", "sysroot"])
            .output()
            .ok()?;
        let sysroot = PathBuf::from(String::from_utf8_lossy(&sysroot.stdout).trim().to_string());
        if sysroot
            .join("lib/rustlib")
            .join(target)
            .join("lib")
            .is_dir()
        {
            return Some(Self::Rustup);
        }
        let sources = Path::new(DEBIAN_SOURCES).is_dir() || library_of_debian().is_some();
        let debian =
            Path::new(DEBIAN_CARGO).is_file() && Path::new(DEBIAN_RUSTC).is_file() && sources;
        let linkers = [
            Some(PathBuf::from("/usr/bin/lld-22")),
            rust_lld(&sysroot),
            Some(PathBuf::from("/usr/bin/arm-none-eabi-ld")),
        ];
        let linker = linkers
            .into_iter()
            .flatten()
            .find(|linker| linker.is_file())?;
        debian.then_some(Self::Debian(linker))
    }

    /// Name of the toolchain for messages.
    pub fn name(&self) -> String {
        match self {
            Self::Rustup => "the toolchain's own target".to_string(),
            Self::Debian(linker) => format!(
                "Debian's rustc-web with rust-web-src, linked by {}",
                linker.display()
            ),
        }
    }

    /// Returns its cargo, set up for a target.
    pub fn cargo(&self, target: &str) -> Command {
        match self {
            Self::Rustup => crate::cargo(),
            Self::Debian(linker) => {
                let mut cargo = Command::new(DEBIAN_CARGO);
                // Variables set by the toolchain that runs this program do not apply to the other
                // one.
                for (name, _) in env::vars_os() {
                    let text = name.to_string_lossy();
                    if text.starts_with("CARGO") && text != "CARGO_HOME" || text.starts_with("RUST")
                    {
                        cargo.env_remove(&name);
                    }
                }
                let linker_of_target = format!(
                    "CARGO_TARGET_{}_LINKER",
                    target.to_uppercase().replace(['-', '.'], "_")
                );
                cargo
                    .env("RUSTC", DEBIAN_RUSTC)
                    .env("RUSTC_BOOTSTRAP", "1")
                    .env(linker_of_target, linker);
                cargo
            }
        }
    }

    /// Returns additional arguments of a build.
    pub fn arguments(&self) -> &'static [&'static str] {
        match self {
            Self::Rustup => &[],
            Self::Debian(_) => &["-Zbuild-std=core"],
        }
    }
}

/// Shortens source paths. A panic contains the path of its file; a short path makes the image small
/// and independent of the folder of the sources.
fn nameless(root: &Path) -> String {
    let home = env::var_os("CARGO_HOME").map(PathBuf::from);
    let home = home.or_else(|| env::var_os("HOME").map(|home| Path::new(&home).join(".cargo")));
    let packages = home
        .and_then(|home| fs::read_dir(home.join("registry/src")).ok())
        .into_iter()
        .flatten()
        .filter_map(|folder| Some(folder.ok()?.path()));
    let library = Path::new(DEBIAN_SOURCES).parent().map(Path::to_path_buf);
    let flags: Vec<String> = [root.to_path_buf()]
        .into_iter()
        .chain(packages)
        .chain(library)
        .map(|folder| {
            format!(
                "{:?}",
                format!("--remap-path-prefix={}/=", folder.display())
            )
        })
        .collect();
    format!("build.rustflags=[{}]", flags.join(", "))
}

/// Path at which Debian's compiler expects the sources of the core library.
fn library_of_debian() -> Option<PathBuf> {
    let output = Command::new(DEBIAN_RUSTC)
        .args(["--print", "sysroot"])
        .output()
        .ok()?;
    let sysroot = PathBuf::from(String::from_utf8_lossy(&output.stdout).trim().to_string());
    Some(sysroot.join("lib/rustlib/src/rust/library/core")).filter(|core| core.is_dir())
}

/// Finds the linker of rustup's toolchains.
fn rust_lld(sysroot: &Path) -> Option<PathBuf> {
    let hosts = fs::read_dir(sysroot.join("lib/rustlib")).ok()?;
    hosts
        .flatten()
        .map(|host| host.path().join("bin/rust-lld"))
        .find(|linker| linker.is_file())
}

impl Board {
    /// Finds a board by name.
    pub fn named(name: &str) -> Option<&'static Self> {
        BOARDS.iter().find(|board| board.name == name)
    }

    /// Finds a toolchain on this computer that builds it.
    pub fn toolchain(&self) -> Option<Toolchain> {
        Toolchain::find(self.target)
    }

    /// Path of an image.
    fn image(&self, root: &Path, binary: &str) -> PathBuf {
        root.join(self.folder)
            .join("target")
            .join(self.target)
            .join("release")
            .join(binary)
    }

    /// Builds the product image.
    pub fn build(&self, root: &Path, quiet: bool) -> Result<PathBuf, String> {
        self.cargo(root, quiet, self.binary, &[], None)
    }

    /// Builds a variant of the product image; its name ends with what differs.
    ///
    /// # Errors
    /// The board has no such option or control period, or the image cannot be built.
    pub fn build_variant(
        &self,
        root: &Path,
        quiet: bool,
        variant: &Variant<'_>,
    ) -> Result<PathBuf, String> {
        let mut arguments = Vec::new();
        if let Some(option) = variant.option
            && !self.options.contains(&option)
        {
            return Err(format!("the board {} has no option '{option}'", self.name));
        }
        if variant.log && !self.has_log {
            return Err(format!("the board {} has no log", self.name));
        }
        for feature in variant.features() {
            arguments.extend(["--features", feature]);
        }
        if variant.period_us.is_some() && self.periods.is_empty() {
            return Err(format!("the board {} has one control period", self.name));
        }
        let built = self.cargo(root, quiet, self.binary, &arguments, variant.period_us)?;
        let image = built.with_file_name(format!("{}{}", self.binary, variant.suffix()));
        if image != built {
            fs::copy(&built, &image).map_err(|error| format!("{}: {error}", image.display()))?;
        }
        Ok(image)
    }

    /// Checks the memory map of an image, and writes it as a UF2 file beside the ELF file. Returns
    /// its path.
    ///
    /// # Errors
    /// The board has no boot ROM that takes UF2 files, or the image is wrong.
    pub fn uf2(&self, image: &Path) -> Result<PathBuf, String> {
        if !self.has_uf2 {
            return Err(format!("the board {} takes no UF2 files", self.name));
        }
        let bytes = fs::read(image).map_err(|error| format!("{}: {error}", image.display()))?;
        let flash =
            crate::uf2::check(&bytes).map_err(|error| format!("{}: {error}", image.display()))?;
        let path = image.with_extension("uf2");
        fs::write(&path, crate::uf2::file(&flash))
            .map_err(|error| format!("{}: {error}", path.display()))?;
        Ok(path)
    }

    /// Builds all images other than the product's, for the emulated runs.
    ///
    /// # Errors
    /// An image cannot be built, or does not fit the memory of the board.
    pub fn build_others(&self, root: &Path) -> Result<(), String> {
        for (name, ..) in self.others {
            self.build_other(root, name)?;
        }
        Ok(())
    }

    /// Builds any image by its name.
    pub fn build_other(&self, root: &Path, name: &str) -> Result<PathBuf, String> {
        match self.others.iter().find(|(other, ..)| *other == name) {
            Some((_, feature, more)) => {
                let words = [&["--features", feature][..], more].concat();
                self.cargo(root, true, name, &words, None)
            }
            None if name == self.binary => self.build(root, true),
            None => {
                let others: Vec<&str> = self.others.iter().map(|(other, ..)| *other).collect();
                Err(format!(
                    "the board {} has no image '{name}'; it has {} and {}",
                    self.name,
                    self.binary,
                    others.join(", ")
                ))
            }
        }
    }

    fn cargo(
        &self,
        root: &Path,
        quiet: bool,
        binary: &str,
        more: &[&str],
        period_us: Option<&str>,
    ) -> Result<PathBuf, String> {
        let toolchain = self.toolchain().ok_or_else(|| {
            format!(
                "no installed toolchain builds for {}: `rustup target add {}`, or on Debian `apt-get install {}`",
                self.target,
                self.target,
                DEBIAN_PACKAGES.join(" ")
            )
        })?;
        if !quiet {
            println!(
                "== board {}: built for {} by {}",
                self.name,
                self.target,
                toolchain.name()
            );
        }
        let mut cargo = toolchain.cargo(self.target);
        cargo
            .current_dir(root.join(self.folder))
            .args(["build", "--release", "--locked", "--target", self.target])
            .args(["--bin", binary])
            .args(["--config", &nameless(root)])
            .args(more)
            .args(toolchain.arguments());
        if quiet {
            cargo.arg("--quiet");
        }
        match period_us {
            Some(period) => cargo.env(PERIOD_VARIABLE, period),
            None => cargo.env_remove(PERIOD_VARIABLE),
        };
        match cargo.status() {
            Ok(status) if status.success() => Ok(self.image(root, binary)),
            Ok(status) => Err(format!(
                "the board {} cannot be built ({status})",
                self.name
            )),
            Err(error) => Err(format!("cargo cannot be started: {error}")),
        }
    }

    /// Checks the format of its sources: they are a workspace of their own, which the format step
    /// of the main workspace does not cover.
    pub fn check_format(&self, root: &Path) -> Result<(), String> {
        let folder = root.join(self.folder);
        let status = crate::cargo()
            .current_dir(&folder)
            // With the code that boards share, which the main workspace leaves out, too.
            .args(["fmt", "--all", "--check"])
            .status();
        match status {
            Ok(status) if status.success() => Ok(()),
            Ok(_) => Err(format!(
                "the sources of the board {} are not formatted: cargo fmt in {}",
                self.name, self.folder
            )),
            Err(error) => Err(format!("cargo cannot be started: {error}")),
        }
    }

    /// Prints the flash and RAM of an image and checks them against the budget.
    pub fn measure(&self, image: &Path) -> Result<(), String> {
        let bytes = fs::read(image).map_err(|error| format!("{}: {error}", image.display()))?;
        let sections = sections(&bytes)
            .ok_or_else(|| format!("{}: is not an image of a 32-bit chip", image.display()))?;
        println!("{:24} {:>10} {:>8}", "section", "address", "bytes");
        let (mut flash, mut ram) = (0, 0);
        for section in sections
            .iter()
            .filter(|section| section.allocated && section.bytes > 0)
        {
            let what = match (section.writable, section.in_file) {
                (false, _) => "flash",
                (true, true) => "flash and RAM",
                (true, false) => "RAM",
            };
            println!(
                "{:24} {:#010x} {:>8}  {what}",
                section.name, section.address, section.bytes
            );
            if !section.writable || section.in_file {
                flash += section.bytes;
            }
            if section.writable {
                ram += section.bytes;
            }
        }
        println!(
            "flash {flash} of {}, static RAM {ram} of {}",
            self.flash, self.ram
        );
        if flash > self.flash || ram > self.ram {
            return Err(format!(
                "the image of {} exceeds its flash or RAM budget",
                self.name
            ));
        }
        Ok(())
    }
}

/// Section of an image.
struct Section {
    name: String,
    address: u64,
    bytes: u64,
    allocated: bool,
    writable: bool,
    in_file: bool,
}

/// Reads the sections of a little-endian 32-bit ELF file; `None` for other files.
fn sections(bytes: &[u8]) -> Option<Vec<Section>> {
    let word = |at: usize| Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?));
    let half = |at: usize| Some(u16::from_le_bytes(bytes.get(at..at + 2)?.try_into().ok()?));
    if bytes.get(..6)? != [0x7F, b'E', b'L', b'F', 1, 1] {
        return None;
    }
    let (table, size, count, names) = (word(32)? as usize, half(46)?, half(48)?, half(50)?);
    let header = |index: u16| table + usize::from(index) * usize::from(size);
    let names_at = word(header(names) + 16)? as usize;
    let mut found = Vec::new();
    for index in 0..count {
        let at = header(index);
        let name = bytes.get(names_at + word(at)? as usize..)?;
        let name = name.split(|&byte| byte == 0).next()?;
        let flags = word(at + 8)?;
        found.push(Section {
            name: String::from_utf8_lossy(name).into_owned(),
            address: u64::from(word(at + 12)?),
            bytes: u64::from(word(at + 20)?),
            allocated: flags & 2 != 0,
            writable: flags & 1 != 0,
            // A section without contents in the file (type 8) is zeroed memory.
            in_file: word(at + 4)? != 8,
        });
    }
    Some(found)
}
