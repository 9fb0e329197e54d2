//! Loading of the definitions: parsing, and checks of all references.

use super::{BandDefinition, Experiment};
use crate::inputs::input;
use crate::measures;
use haptimill_client::{Error, ErrorKind};
use std::collections::BTreeMap;

macro_rules! files {
    ($folder:literal: $($name:literal)*) => {
        &[$((
            concat!($folder, $name),
            include_str!(concat!("../../../../", $folder, $name)),
        )),*]
    };
}

/// Definitions, in the order of the thesis.
pub(super) const DEFINITIONS: &[(&str, &str)] = files!("host/experiments/data/":
    "e1.toml" "e2.toml" "e3.toml" "e4.toml" "e5.toml" "e6.toml"
    "e7.toml" "e8.toml" "e9.toml" "e10.toml" "e11.toml" "e12.toml");

impl Experiment {
    /// Parses and checks a definition; `file` is its name in messages.
    ///
    /// # Errors
    /// The text is not such a file, or refers to something that it does not define. The message
    /// names the file and the key.
    pub fn parse(file: &str, text: &str) -> Result<Self, String> {
        let experiment: Self = toml::from_str(text).map_err(|error| {
            let start = error.span().map_or(0, |span| span.start);
            let before = text.get(..start).unwrap_or_default();
            let line = before.matches('\n').count() + 1;
            let column = before.chars().rev().take_while(|c| *c != '\n').count() + 1;
            let message = error.message().replace('\n', "; ");
            format!("{file}:{line}:{column}: {message}")
        })?;
        let problem = |problem: String| format!("{file}: {problem}");
        experiment.check().map_err(problem)?;
        Ok(experiment)
    }

    fn check(&self) -> Result<(), String> {
        if self.passes.is_empty() {
            return Err("pass: there must be at least one".to_string());
        }
        for pass in &self.passes {
            for (key, path) in [("program", &pass.program), ("stock", &pass.stock)] {
                if input(path).is_none() {
                    let name = &pass.name;
                    return Err(format!(
                        "pass \"{name}\": {key}: \"{path}\" is not built in"
                    ));
                }
            }
        }
        for (name, event) in &self.events {
            if event.completed == event.master_x_mm.is_some() {
                let keys = "master_x_mm, completed";
                return Err(format!(
                    "events.{name}: exactly one of {keys} must be present"
                ));
            }
        }
        for (name, window) in &self.windows {
            let place = format!("windows.{name}");
            let event = window.to_event.as_ref();
            known(&self.events, event, &format!("{place}.to_event"))?;
            if window.from_fraction.is_some() && event.is_none() {
                return Err(format!("{place}.from_fraction: to_event is missing"));
            }
        }
        for expected in &self.expected {
            let place = format!("expected \"{}\"", expected.name);
            let BandDefinition { min, max, .. } = expected.band;
            let is_ordered = min.is_none_or(|min| max.is_none_or(|max| min <= max));
            if !is_ordered || min.is_none() && max.is_none() {
                return Err(format!("{place}: band: needs min or max, and min <= max"));
            }
            known(
                &self.reasons,
                expected.reason.as_ref(),
                &format!("{place}: reason"),
            )?;
            let measure = &expected.measure;
            if let (Some(reason), Some(pass)) = (self.reason_of(expected), self.pass_of(measure)) {
                measures::check_cause(reason, &self.passes[pass])
                    .map_err(|problem| format!("{place}: reason: {problem}"))?;
            }
            let elsewhere = measure.less.iter().chain(&measure.over);
            let moved = elsewhere.map(|elsewhere| measure.moved_to(elsewhere));
            for measure in std::iter::once(measure.clone()).chain(moved) {
                for window in &measure.windows {
                    let place = format!("{place}: measure.windows");
                    known(&self.windows, Some(window), &place)?;
                }
                let event = measure.event.as_ref();
                known(&self.events, event, &format!("{place}: measure.event"))?;
                let pass = self.pass_of(&measure);
                let pass = pass.ok_or_else(|| format!("{place}: measure.pass is not defined"))?;
                measures::check(&measure, &self.passes[pass])
                    .map_err(|problem| format!("{place}: measure.{problem}"))?;
            }
        }
        Ok(())
    }
}

fn known<T>(table: &BTreeMap<String, T>, key: Option<&String>, place: &str) -> Result<(), String> {
    match key {
        Some(key) if !table.contains_key(key) => Err(format!("{place}: \"{key}\" is not defined")),
        _ => Ok(()),
    }
}

/// All experiments, in the order of the thesis.
///
/// # Errors
/// A definition is not valid; the message names the file and the key.
pub fn all() -> Result<Vec<Experiment>, Error> {
    let definitions = DEFINITIONS.iter();
    definitions
        .map(|(file, text)| {
            Experiment::parse(file, text).map_err(|error| Error::new(ErrorKind::Internal, error))
        })
        .collect()
}
