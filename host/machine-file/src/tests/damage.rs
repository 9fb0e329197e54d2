//! Damaged and odd machine files: problems, never a panic.

use crate::*;
use proptest::prelude::*;

#[test]
fn deep_nesting_and_odd_bytes_are_problems() {
    for text in [
        format!("a = {}", "[".repeat(100_000)),
        format!("a = {}", "{b = ".repeat(100_000)),
        format!("[{}a]", "a.".repeat(2_000)),
        format!("{}a = 1", "a.".repeat(2_000)),
        "\u{feff}name = \"h4\"\r\n".to_string(),
        "name = \"h4\0\"".to_string(),
    ] {
        assert!(MachineFile::parse("odd", &text).is_err());
    }
    let file = tempfile::NamedTempFile::new().unwrap().into_temp_path();
    std::fs::write(&file, [b'a', 0xFF, 0xFE]).unwrap();
    let Err(problems) = MachineFile::load(&file) else {
        panic!("it is valid")
    };
    assert!(problems.to_string().contains("is not UTF-8 at byte 1"));
    std::fs::write(&file, b"").unwrap();
    assert!(MachineFile::load(&file).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn text_never_panics(text in "\\PC{0,400}") {
        let _ = MachineFile::parse("any", &text);
    }

    #[test]
    fn damaged_file_never_panics(
        at in 0..BUILT_IN.len(),
        length in 0usize..40,
        bytes in prop::collection::vec(any::<u8>(), 0..12),
    ) {
        let mut text = BUILT_IN.as_bytes().to_vec();
        text.splice(at..(at + length).min(text.len()), bytes);
        if let Ok(machine) = MachineFile::parse("damaged", &String::from_utf8_lossy(&text)) {
            prop_assert!(machine.encoded().is_ok());
        }
    }

    #[test]
    fn any_number_is_accepted_or_reported(value in any::<f64>(), which in 0usize..200) {
        // Replaces one number of the file.
        let mut seen = 0;
        let lines: Vec<String> = BUILT_IN.lines().map(|line| {
            let numeric = line.split_once(" = ").filter(|(key, value)| {
                !key.starts_with('#') && value.starts_with(|c: char| c.is_ascii_digit() || c == '-')
            });
            match numeric {
                Some((key, _)) => {
                    seen += 1;
                    if seen - 1 == which { format!("{key} = {value:?}").to_lowercase() } else { line.to_string() }
                }
                None => line.to_string(),
            }
        }).collect();
        if let Ok(machine) = MachineFile::parse("any number", &lines.join("\n")) {
            prop_assert!(machine.encoded().is_ok());
        }
    }
}
