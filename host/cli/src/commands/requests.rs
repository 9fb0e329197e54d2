//! Requests of other processes of the user to the process that commands a machine (`haptimill
//! override`, `hold`, `resume`).

#[cfg(unix)]
use haptimill_client::port::Control;
use haptimill_client::port::PortSpec;
use serde_json::{Value, json};

/// A request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Request {
    /// Feed, rapid and spindle override, percent, within their ranges; none of them asks for the
    /// present ones.
    Override([Option<u8>; 3]),
    /// Hold the job along its path.
    Hold,
    /// End a hold or a pause.
    Resume,
    /// Report the status, for `haptimill status`.
    Status,
}

/// The request for the status.
#[cfg(unix)]
pub(crate) const STATUS_REQUEST: &str = r#"{"command":"status"}"#;

/// Why there is no status.
pub(crate) const NO_REPORT: &str = "the controller has not reported yet";

/// Names and ranges of the overrides, percent.
const RANGES: [(&str, u8, u8); 3] = [("feed", 0, 200), ("rapid", 0, 100), ("spindle", 10, 200)];

/// Checks overrides of feed, rapid moves and spindle, percent.
///
/// # Errors
/// One is out of its range.
pub(crate) fn check_overrides(percents: [Option<u8>; 3]) -> Result<(), String> {
    for ((name, low, high), percent) in RANGES.into_iter().zip(percents) {
        if let Some(percent) = percent.filter(|percent| !(low..=high).contains(percent)) {
            return Err(format!(
                "{name} override {percent} %: it is {low} to {high} %"
            ));
        }
    }
    Ok(())
}

/// Describes overrides of feed, rapid moves and spindle.
pub(crate) fn describe_overrides([feed, rapid, spindle]: [u8; 3]) -> String {
    format!("overrides: feed {feed} %, rapid {rapid} %, spindle {spindle} %")
}

impl Request {
    fn parse(text: &str) -> Result<Self, String> {
        let request: Value = serde_json::from_str(text).map_err(|error| error.to_string())?;
        match request["command"].as_str() {
            Some("override") => {
                let percents = RANGES.map(|(key, ..)| {
                    let percent = request[key].as_u64();
                    // A number that is too large is refused as out of range.
                    percent.map(|percent| u8::try_from(percent).unwrap_or(u8::MAX))
                });
                check_overrides(percents)?;
                Ok(Self::Override(percents))
            }
            Some("hold") => Ok(Self::Hold),
            Some("resume") => Ok(Self::Resume),
            Some("status") => Ok(Self::Status),
            _ => Err("the request is not known; use the same version of haptimill".into()),
        }
    }
}

/// The socket of the requests.
#[derive(Default)]
pub(crate) struct Requests {
    #[cfg(unix)]
    control: Option<Control>,
}

impl Requests {
    /// Listens for requests to the process that commands the machine of a port; a simulator in the
    /// process takes none.
    ///
    /// # Errors
    /// Why there are none. The machine works without them.
    #[cfg(unix)]
    pub(crate) fn listen(port: &PortSpec) -> Result<Self, String> {
        let is_port = matches!(port, PortSpec::Tcp(_) | PortSpec::Serial(_));
        let control = is_port.then(|| Control::listen(port)).transpose();
        let control = control.map_err(|error| error.to_string())?;
        Ok(Self { control })
    }

    /// Other systems have no requests.
    #[cfg(not(unix))]
    pub(crate) fn listen(_: &PortSpec) -> Result<Self, String> {
        Ok(Self {})
    }

    /// Answers the requests that have arrived; never waits. `answer` describes what was done, or
    /// why it is not done.
    pub(crate) fn serve(&mut self, mut answer: impl FnMut(Request) -> Result<String, String>) {
        #[cfg(unix)]
        if let Some(control) = &mut self.control {
            control.serve(|text| match Request::parse(text).and_then(&mut answer) {
                Ok(what) => json!({ "done": what }).to_string(),
                Err(what) => json!({ "error": what }).to_string(),
            });
        }
        #[cfg(not(unix))]
        let _ = (&mut answer, json!(null));
    }
}
