//! Names of machines in general code.
//!
//! A machine is its own modules, rows in lists, and its machine file. No other source names a
//! machine, its coordinates, its joints or its parts: general code asks the descriptor. The names
//! are read from the descriptors (`firmware/kinematics/src`), so a new machine is held, too.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// Folder with the descriptors of all machines.
const DESCRIPTORS: &str = "firmware/kinematics/src";

/// Folders whose sources are checked.
const CHECKED: &[&str] = &["protocol", "firmware", "hil-sim", "host", "tests/src"];

/// Folders of sources about one machine: tests and examples may name it.
const ABOUT_MACHINES: &[&str] = &["tests", "benches", "examples"];

/// Parts of machines whose names no descriptor has.
const PARTS: &[&str] = &["slide", "slides"];

/// Names of descriptors that are ordinary words of general code. A code among them counts where it
/// is the code without doubt: see [`names_model`].
const ORDINARY: &[&str] = &["cartesian", "facet", "height", "angle", "index"];

/// Files and folders that may name machines, and why.
const EXCEPTIONS: &[(&str, &str)] = &[
    // Lists with a row per machine.
    (
        "firmware/kinematics/src/machines/mod.rs",
        "list of machines",
    ),
    ("hil-sim/src/machines/mod.rs", "list of geometries"),
    ("host/machine-file/src/models/mod.rs", "list of models"),
    ("host/cli/src/commands/machine/init.rs", "list of templates"),
    // The haptic arm has slides of its own.
    ("firmware/kinematics/src/haptic_arm/", "haptic arm"),
    ("firmware/src/haptics/", "haptic arm"),
    (
        "firmware/src/io.rs",
        "encoders and motors of the haptic arm",
    ),
    ("hil-sim/src/haptics/", "haptic arm"),
    ("hil-sim/src/fault/haptic.rs", "faults of the haptic arm"),
    ("hil-sim/src/fault/catalogue.rs", "faults of the haptic arm"),
    ("host/machine-file/src/haptic.rs", "haptic arm"),
    ("host/machine-keys/src/haptic.rs", "haptic arm"),
    ("protocol/src/haptic.rs", "haptic arm"),
    ("protocol/src/text/haptic.rs", "haptic arm"),
    // Gems, and the machine that cuts them.
    ("host/facet/", "gems"),
    ("host/cli/src/commands/facet.rs", "gems"),
    // Experiments and references of one machine.
    ("host/experiments/", "experiments of the thesis"),
    ("host/calibration/src/arm.rs", "calibration of one machine"),
    ("host/calibration/src/lib.rs", "its row in a list"),
    ("host/machine-file/src/migrate.rs", "names of format 1"),
    (
        "host/cli/src/commands/calibrate.rs",
        "the command of that calibration",
    ),
    ("firmware/checks/src/", "checks of the reference machine"),
    // Three quarters of the episodes of the fuzz test are on the H-4 machines.
    ("tests/src/fuzz/machines.rs", "list of machine files"),
    (
        "tests/src/fuzz/reference.rs",
        "reference of the H-4 machines",
    ),
    ("tests/src/fuzz/episode.rs", "joints of the H-4 machines"),
    ("tests/src/fuzz/script/", "scripts of the H-4 machines"),
    ("tests/src/bin/fuzz.rs", "option for the H-4 machines"),
    (
        "firmware/boards/mps2/src/bin/checks.rs",
        "checks of the reference machine",
    ),
];

/// Words that a file or folder may use, although they are parts of machines.
const WORDS: &[(&str, &str)] = &[
    // The driven side of a screw, in the models of backlash and mechanics.
    ("firmware/src/joint/", "slide"),
    ("hil-sim/src/joint/", "slide"),
    ("hil-sim/src/joint/", "slides"),
    ("host/machine-keys/src/plant.rs", "slide"),
    ("host/machine-keys/src/plant.rs", "slides"),
    // The driven side of a screw, and the choice of the H-4 machines.
    ("tests/src/fuzz/", "slide"),
    ("tests/src/fuzz/", "slides"),
    ("tests/src/fuzz/", "h4"),
    // The angles of the haptic arm.
    ("host/machine-keys/src/plant.rs", "theta1"),
    ("host/machine-keys/src/plant.rs", "theta2"),
    ("hil-sim/src/plant.rs", "slide"),
    ("hil-sim/src/plant.rs", "slides"),
    ("hil-sim/src/plant/", "slide"),
    ("hil-sim/src/plant/", "slides"),
];

/// Checks all sources below `root`.
///
/// # Errors
///
/// Returns the number of places that name a machine, or the file that cannot be read.
pub fn lint(root: &Path) -> Result<(), String> {
    let names = names(root)?;
    let mut files = Vec::new();
    for folder in CHECKED {
        super::lint::list(&root.join(folder), &[".rs", ".md"], &mut files)?;
    }
    files.sort();
    let mut count = 0;
    for path in files {
        let name = path.strip_prefix(root).unwrap_or(&path);
        let shown = name.display().to_string().replace('\\', "/");
        if !shown.ends_with(".rs") || is_free(&shown, &names) {
            continue;
        }
        let text =
            fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))?;
        let is_allowed = |word: &str| {
            WORDS
                .iter()
                .any(|(free, allowed)| shown.starts_with(free) && *allowed == word)
        };
        for (line, word) in named(&text, &names) {
            if is_allowed(&word) {
                continue;
            }
            println!("{shown}:{line}: names \"{word}\"");
            count += 1;
        }
    }
    match count {
        0 => Ok(()),
        count => Err(format!(
            "{count} places of general code name a machine or its parts; ask the descriptor \
             (docs/adding-a-machine.md), or move the code to the files of the machine"
        )),
    }
}

/// Names of all machines: codes, and names of coordinates and joints of three letters or more;
/// shorter ones are words of general code, too.
#[derive(Debug, Default)]
struct Names {
    codes: BTreeSet<String>,
    words: BTreeSet<String>,
}

/// Reads the names from the descriptors.
fn names(root: &Path) -> Result<Names, String> {
    let mut files = Vec::new();
    super::lint::list(&root.join(DESCRIPTORS), &[".rs"], &mut files)?;
    let mut names = Names::default();
    for path in files {
        let text =
            fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))?;
        names.add(&text);
    }
    if names.codes.is_empty() {
        return Err(format!("{DESCRIPTORS} has no descriptor of a machine"));
    }
    names.words.extend(PARTS.iter().map(ToString::to_string));
    Ok(names)
}

impl Names {
    /// Adds the names of a source: the texts of its descriptors.
    fn add(&mut self, text: &str) {
        let text = text.split("#[cfg(test)]").next().unwrap_or_default();
        let mut descriptors = text.split("Descriptor {");
        descriptors.next();
        for descriptor in descriptors {
            // A descriptor is a constant; functions come behind it.
            let descriptor = descriptor.split("fn ").next().unwrap_or_default();
            let code = descriptor.trim_start().starts_with("code: ");
            for (index, word) in descriptor.split('"').skip(1).step_by(2).enumerate() {
                let word = word.to_lowercase();
                let is_code = code && index == 0;
                if is_code && word != "none" {
                    self.codes.insert(word.clone());
                }
                let ordinary = ORDINARY.contains(&word.as_str()) || word == "none";
                if word.len() > 2 && !ordinary {
                    self.words.insert(word);
                }
            }
        }
    }
}

/// Whether a file may name machines: it belongs to one, is about one, or is an exception.
fn is_free(name: &str, names: &Names) -> bool {
    // The sources of the crate of whole-system tests are general code.
    let inner = name.strip_prefix("tests/src/").unwrap_or(name);
    let mut parts = inner.split('/').map(|part| part.trim_end_matches(".rs"));
    parts.any(|part| ABOUT_MACHINES.contains(&part) || names.codes.contains(part))
        || EXCEPTIONS.iter().any(|(free, _)| name.starts_with(free))
}

/// Returns line and word of every name of a machine in a source without its tests. The name of a
/// machine file, as `machines/mill.toml`, is no name of a machine.
fn named(text: &str, names: &Names) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for (index, line) in text.lines().enumerate() {
        if line.trim() == "#[cfg(test)]" && text.lines().nth(index + 1).is_some_and(is_module) {
            break;
        }
        let line = without_files(line);
        let words = words(&line);
        // Each part of a name counts; a code of several parts counts as a whole.
        for code in &names.codes {
            let parts: Vec<&str> = code.split('_').collect();
            let is_word = parts.len() == 1 && names.words.contains(code);
            let is_named = if ORDINARY.contains(&code.as_str()) {
                names_model(&line, code)
            } else {
                !is_word && words.windows(parts.len()).any(|window| window == parts)
            };
            if is_named {
                found.push((index + 1, code.clone()));
            }
        }
        found.extend(
            words
                .into_iter()
                .filter(|word| names.words.contains(word))
                .map(|word| (index + 1, word)),
        );
    }
    found
}

/// Whether a line has a code of one part as a variant of the lists, a module, a quoted text, or a
/// section of a machine file.
fn names_model(line: &str, code: &str) -> bool {
    let (first, rest) = code.split_at(1);
    let variant = format!("{}{rest}", first.to_uppercase());
    let has = |before: &str, name: &str, is_end: fn(char) -> bool| {
        let whole = format!("{before}{name}");
        line.match_indices(&whole)
            .any(|(at, found)| line[at + found.len()..].chars().next().is_none_or(is_end))
    };
    let ends_name = |c: char| !(c.is_ascii_alphanumeric() || c == '_');
    has("Model::", &variant, ends_name)
        || has("Config::", &variant, ends_name)
        || has("machines::", code, ends_name)
        || has("geometry.", code, ends_name)
        || has("\"", code, |c| c == '"' || c == '\\')
}

fn is_module(line: &str) -> bool {
    line.starts_with("mod ") && line.ends_with('{')
}

/// Removes the names of machine files.
fn without_files(line: &str) -> String {
    let mut kept = String::new();
    let mut rest = line;
    while let Some(at) = rest.find("machines/") {
        let (before, file) = rest.split_at(at);
        kept.push_str(before);
        let ends = |c: char| !(c.is_ascii_alphanumeric() || "/-_.".contains(c));
        rest = &file[file.find(ends).unwrap_or(file.len())..];
    }
    kept.push_str(rest);
    kept.replace("H-4", "H4")
}

/// Returns the words of a line, in small letters; an identifier is one word for each of its parts.
fn words(line: &str) -> Vec<String> {
    let mut words = Vec::new();
    let mut word = String::new();
    let mut before = ' ';
    for character in line.chars().chain([' ']) {
        let begins = character.is_ascii_uppercase() && !before.is_ascii_uppercase();
        if (begins || !character.is_ascii_alphanumeric()) && !word.is_empty() {
            words.push(std::mem::take(&mut word).to_lowercase());
        }
        if character.is_ascii_alphanumeric() {
            word.push(character);
        }
        before = character;
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    const DESCRIPTOR: &str = "
        const DESCRIPTOR: Descriptor = Descriptor {
            code: \"scara\",
            pose: &[CoordinateDescriptor {
                name: \"x\",
            }],
            joints: &[JointDescriptor {
                name: \"elbow\",
            }],
        };
        const NO_MACHINE: Descriptor = Descriptor {
            code: \"none\",
        };";

    fn scara() -> Names {
        let mut names = Names::default();
        names.add(DESCRIPTOR);
        names
    }

    #[test]
    fn a_name_in_general_code_is_found() {
        let names = scara();
        for (line, word) in [
            ("if machine.code == \"scara\" {", "scara"),
            ("let elbow = joints[1];", "elbow"),
            ("let elbow_rate = 1.0;", "elbow"),
            ("/// Angle of the elbow.", "elbow"),
            ("use haptimill_kinematics::scara::Scara;", "scara"),
            ("Model::Scara(geometry) => {", "scara"),
            ("struct ScaraGeometry;", "scara"),
        ] {
            let text = format!("fn general() {{}}\n{line}\n");
            let found = named(&text, &names);
            assert_eq!(found.first(), Some(&(2, word.to_string())), "{line}");
        }
        for line in [
            "/// See machines/scara.toml.",
            "include_str!(\"../../machines/scara-elbow.toml\")",
            "let x = 1;",
            "let elbows = none;",
        ] {
            assert_eq!(named(line, &names), [], "{line}");
        }
        let tests = "fn general() {}\n\n#[cfg(test)]\nmod tests {\n    // scara\n}\n";
        assert_eq!(named(tests, &names), []);
    }

    /// Codes of two letters and of several parts are found as well.
    #[test]
    fn short_and_divided_codes_are_found() {
        let mut names = Names::default();
        names.add("Descriptor {\n code: \"h4\", }; Descriptor {\n code: \"five_bar\", };");
        for (line, code) in [
            ("GeometryConfig::H4(geometry) => {", "h4"),
            ("/// Of the H-4 arm.", "h4"),
            ("if code == \"five_bar\" {", "five_bar"),
            ("Model::FiveBar(geometry) => {", "five_bar"),
        ] {
            assert_eq!(named(line, &names), [(1, code.to_string())], "{line}");
        }
        for line in ["let h = 4;", "let five = 5;", "/// See machines/h4.toml."] {
            assert_eq!(named(line, &names), [], "{line}");
        }
    }

    /// A code that is also a word of general code is found as a code, not as the word.
    #[test]
    fn codes_that_are_ordinary_words_are_found() {
        let mut names = Names::default();
        names.add("Descriptor {\n code: \"cartesian\", }; Descriptor {\n code: \"facet\", };");
        for (line, code) in [
            ("Some(GeometryConfig::Cartesian(config)) => {", "cartesian"),
            (
                "name a machine with the model \\\"cartesian\\\"",
                "cartesian",
            ),
            ("add [plant.geometry.cartesian] with errors", "cartesian"),
            ("if code == \"facet\" {", "facet"),
            ("use haptimill_hil_sim::machines::facet::Facet;", "facet"),
        ] {
            let found = named(line, &names);
            assert!(found.contains(&(1, code.to_string())), "{line}: {found:?}");
        }
        for line in [
            "/// Names of the Cartesian components.",
            "let facet = facets.next();",
            "pocket on the Cartesian mill",
            "Command::Facet(command) => facet::run(command),",
        ] {
            assert_eq!(named(line, &names), [], "{line}");
        }
    }

    #[test]
    fn files_of_a_machine_may_name_it() {
        let names = scara();
        for free in [
            "firmware/kinematics/src/machines/scara.rs",
            "firmware/kinematics/src/machines/scara/motion.rs",
            "hil-sim/src/machines/scara.rs",
            "host/planner/tests/plan/scara.rs",
            "host/machine-file/src/models/mod.rs",
            "host/cli/tests/cli.rs",
        ] {
            assert!(is_free(free, &names), "{free}");
        }
        for checked in [
            "host/cli/src/kin.rs",
            "firmware/src/force/mod.rs",
            "hil-sim/src/plant.rs",
        ] {
            assert!(!is_free(checked, &names), "{checked}");
        }
    }

    /// A violation that is added to a copy of the tree is found, and only there.
    #[test]
    fn an_added_file_fails_the_lint() {
        let folder = std::env::temp_dir().join(format!("haptimill-names-{}", std::process::id()));
        let write = |name: &str, text: &str| {
            let path = folder.join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        };
        for checked in CHECKED {
            fs::create_dir_all(folder.join(checked)).unwrap();
        }
        write("firmware/kinematics/src/machines/scara.rs", DESCRIPTOR);
        write("host/report/src/lib.rs", "fn general() {}\n");
        assert_eq!(lint(&folder), Ok(()));
        write("host/report/src/lib.rs", "fn elbow_error() {}\n");
        let problem = lint(&folder).unwrap_err();
        assert!(problem.starts_with("1 places"), "{problem}");
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn every_exception_exists() {
        for (free, _) in EXCEPTIONS.iter().chain(WORDS) {
            assert!(crate::root().join(free).exists(), "{free}");
        }
    }
}
