//! `haptimill-log IMAGE LOG`: prints the log of an emulated chip as text (`cargo xtask log`).

mod decode;

use std::process::ExitCode;

fn main() -> ExitCode {
    let files: Vec<_> = std::env::args_os().skip(1).collect();
    let [image, log] = &files[..] else {
        eprintln!("haptimill-log IMAGE LOG");
        return ExitCode::from(2);
    };
    let read = |file| {
        std::fs::read(file)
            .map_err(|error| format!("{}: {error}", std::path::Path::new(file).display()))
    };
    let lines = read(image).and_then(|image| decode::decode(&image, &read(log)?));
    match lines {
        Ok(lines) => {
            lines.iter().for_each(|line| println!("{line}"));
            ExitCode::SUCCESS
        }
        Err(problem) => {
            eprintln!("haptimill-log: {problem}");
            ExitCode::FAILURE
        }
    }
}
