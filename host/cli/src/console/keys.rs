//! Key table: the source of the key input, the help and the documentation.
//!
//! Four keys are always active, whatever is open on the screen, while text is typed and while the
//! link is down: hold, resume, stop, emergency stop. None of them is a plain letter, so typed text
//! never triggers them.
//!
//! A slow line may split the byte sequence of a key: Escape, then `[`, digits, capital letters,
//! `~`. None of these fragments has an irreversible action; Escape alone holds.

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

/// Action of a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Decelerate; a job keeps its place.
    Hold,
    /// Continue the job.
    Resume,
    /// Decelerate; a job is aborted.
    Stop,
    /// Switch the drives off at once.
    Emergency,
    /// Quit the console.
    Quit,
    /// Switch the drives on.
    Enable,
    /// Switch the drives off at standstill.
    Disable,
    /// Home the machine.
    Home,
    /// Move a joint off its limit switch.
    MoveOff,
    /// Clear a latched fault.
    Reset,
    /// Move a pose coordinate.
    Jog {
        /// Index of the coordinate.
        coordinate: u8,
        /// Positive direction.
        up: bool,
    },
    /// Toggle continuous jog and steps.
    Mode,
    /// A slower jog, or a smaller step.
    Decrease,
    /// A faster jog, or a larger step.
    Increase,
    /// More feed override.
    OverrideUp,
    /// Less feed override.
    OverrideDown,
    /// More rapid override.
    RapidUp,
    /// Less rapid override.
    RapidDown,
    /// More spindle override.
    SpindleUp,
    /// Less spindle override.
    SpindleDown,
    /// Select a part program.
    Program,
    /// Set a work offset from the present position.
    Zero,
    /// Select the source of each coordinate.
    Sources,
    /// Set the force loops.
    Force,
    /// Open the master panel.
    Master,
    /// Set the zero of the force sensor.
    Tare,
    /// Start or stop a recording.
    Record,
    /// Show the key table.
    Help,
    /// Close what is open, else hold.
    Close,
}

/// A key as reported by a terminal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Key {
    /// Key code.
    pub code: KeyCode,
    /// Ctrl is pressed.
    pub control: bool,
}

/// A row of the key table.
#[derive(Debug, Clone, Copy)]
pub struct Binding {
    /// Equivalent keys.
    pub keys: &'static [Key],
    /// Displayed name of the keys.
    pub name: &'static str,
    /// Action of the keys.
    pub action: Action,
    /// Description; empty for jog keys, see [`Binding::describe`].
    pub description: &'static str,
    /// Active in every overlay and while text is typed.
    pub always_active: bool,
}

const fn plain(letter: char) -> Key {
    Key {
        code: KeyCode::Char(letter),
        control: false,
    }
}

const fn control(letter: char) -> Key {
    Key {
        code: KeyCode::Char(letter),
        control: true,
    }
}

const fn special(code: KeyCode) -> Key {
    Key {
        code,
        control: false,
    }
}

const fn always_active(
    keys: &'static [Key],
    name: &'static str,
    action: Action,
    description: &'static str,
) -> Binding {
    Binding {
        always_active: true,
        ..bind(keys, name, action, description)
    }
}

const fn bind(
    keys: &'static [Key],
    name: &'static str,
    action: Action,
    description: &'static str,
) -> Binding {
    Binding {
        keys,
        name,
        action,
        description,
        always_active: false,
    }
}

const fn jog(keys: &'static [Key], name: &'static str, coordinate: u8, up: bool) -> Binding {
    bind(keys, name, Action::Jog { coordinate, up }, "")
}

/// All keys. A jog key moves the pose coordinate of its index, whose name is in the machine file.
pub const BINDINGS: &[Binding] = &[
    always_active(
        &[plain(' '), special(KeyCode::F(5))],
        "Space, F5",
        Action::Hold,
        "hold: decelerate; a program keeps its place, a jog or homing ends",
    ),
    always_active(
        &[control('r'), special(KeyCode::F(6))],
        "Ctrl-R, F6",
        Action::Resume,
        "resume after a hold or a program pause",
    ),
    always_active(
        &[control('x'), special(KeyCode::F(7))],
        "Ctrl-X, F7",
        Action::Stop,
        "stop: decelerate along the path and drop the program; the position is kept",
    ),
    always_active(
        &[control('e'), special(KeyCode::F(8))],
        "Ctrl-E, F8",
        Action::Emergency,
        "emergency stop: drives off at once, latched until reset",
    ),
    jog(&[special(KeyCode::Right)], "Right", 0, true),
    jog(&[special(KeyCode::Left)], "Left", 0, false),
    jog(&[special(KeyCode::Up)], "Up", 1, true),
    jog(&[special(KeyCode::Down)], "Down", 1, false),
    jog(&[special(KeyCode::PageUp)], "PageUp", 2, true),
    jog(&[special(KeyCode::PageDown)], "PageDown", 2, false),
    jog(&[plain('.')], ".", 3, true),
    jog(&[plain(',')], ",", 3, false),
    jog(&[plain('m')], "m", 4, true),
    jog(&[plain('n')], "n", 4, false),
    jog(&[plain('k')], "k", 5, true),
    jog(&[plain('j')], "j", 5, false),
    bind(
        &[special(KeyCode::Tab)],
        "Tab",
        Action::Mode,
        "toggle continuous jog and one step per key press",
    ),
    bind(
        &[plain('f')],
        "f",
        Action::Increase,
        "faster jog; in step mode, the next larger step",
    ),
    bind(
        &[plain('s')],
        "s",
        Action::Decrease,
        "slower jog; in step mode, the next smaller step",
    ),
    bind(&[plain('e')], "e", Action::Enable, "enable: drives on"),
    bind(
        &[plain('d')],
        "d",
        Action::Disable,
        "disable: drives off, at standstill",
    ),
    bind(
        &[plain('h')],
        "h",
        Action::Home,
        "home: find the references, then move to the home pose (asks first)",
    ),
    bind(
        &[plain('b')],
        "b",
        Action::MoveOff,
        "move a joint off its limit switch, after a reset of that fault (asks first)",
    ),
    bind(
        &[plain('x')],
        "x",
        Action::Reset,
        "reset a latched fault or emergency stop",
    ),
    bind(
        &[plain('p')],
        "p",
        Action::Program,
        "part program: select, check, run (asks first)",
    ),
    bind(
        &[plain('z')],
        "z",
        Action::Zero,
        "zero: make the present position the zero of a work offset",
    ),
    bind(
        &[plain('+'), plain('=')],
        "+",
        Action::OverrideUp,
        "increase the feed override",
    ),
    bind(
        &[plain('-')],
        "-",
        Action::OverrideDown,
        "decrease the feed override",
    ),
    bind(
        &[plain('o')],
        "o",
        Action::RapidUp,
        "increase the rapid override",
    ),
    bind(
        &[plain('i')],
        "i",
        Action::RapidDown,
        "decrease the rapid override",
    ),
    bind(
        &[plain('v')],
        "v",
        Action::SpindleUp,
        "increase the spindle override",
    ),
    bind(
        &[plain('c')],
        "c",
        Action::SpindleDown,
        "decrease the spindle override",
    ),
    bind(
        &[plain('a')],
        "a",
        Action::Sources,
        "sources: source of each coordinate: program, hold, jog or master",
    ),
    bind(
        &[plain('y')],
        "y",
        Action::Force,
        "force control: axes under force control and their force setpoints",
    ),
    bind(
        &[plain('w')],
        "w",
        Action::Master,
        "master: forces, force feedback, virtual fixture, position scale",
    ),
    bind(
        &[plain('t')],
        "t",
        Action::Tare,
        "tare: zero the force sensor (asks first)",
    ),
    bind(
        &[plain('l')],
        "l",
        Action::Record,
        "log: start or stop a recording",
    ),
    bind(
        &[plain('?'), special(KeyCode::F(1))],
        "?, F1",
        Action::Help,
        "show this table",
    ),
    bind(
        &[plain('q'), control('c')],
        "q, Ctrl-C",
        Action::Quit,
        "quit (asks first when drives are on)",
    ),
    bind(
        &[special(KeyCode::Esc)],
        "Esc",
        Action::Close,
        "close what is open; with nothing open, hold",
    ),
];

impl Binding {
    /// Description of the action. `names` are those of the pose coordinates. None for a jog key
    /// without a coordinate.
    #[must_use]
    pub fn describe(&self, names: &[&str]) -> Option<String> {
        let Action::Jog { coordinate, up } = self.action else {
            return Some(self.description.to_string());
        };
        let name = names.get(usize::from(coordinate))?;
        Some(format!("jog {name} {}", if up { "up" } else { "down" }))
    }
}

impl Key {
    /// The key of an event. Upper and lower case differ, except with Ctrl.
    #[must_use]
    pub fn from_event(event: &KeyEvent) -> Self {
        let control = event.modifiers.contains(KeyModifiers::CONTROL);
        let code = match event.code {
            KeyCode::Char(letter) if control => KeyCode::Char(letter.to_ascii_lowercase()),
            code => code,
        };
        Self { code, control }
    }

    fn binding(self) -> Option<&'static Binding> {
        BINDINGS.iter().find(|binding| binding.keys.contains(&self))
    }

    /// Action of the key with nothing open.
    #[must_use]
    pub fn action(self) -> Option<Action> {
        self.binding().map(|binding| binding.action)
    }

    /// Action of the key whatever is open.
    #[must_use]
    pub fn always_active_action(self) -> Option<Action> {
        self.binding()
            .filter(|binding| binding.always_active)
            .map(|binding| binding.action)
    }
}

/// The table in Markdown for docs/console.md. `axes` are the names of the pose coordinates.
#[must_use]
pub fn markdown(axes: &[&str]) -> String {
    let rows: String = BINDINGS
        .iter()
        .filter_map(|row| {
            let mark = if row.always_active {
                ", always active"
            } else {
                ""
            };
            Some(format!(
                "| {} | {}{mark} |\n",
                row.name,
                row.describe(axes)?
            ))
        })
        .collect();
    format!("| key | action |\n| --- | --- |\n{rows}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptimill_machine_file::MachineFile;

    fn key(code: KeyCode, modifiers: KeyModifiers) -> Key {
        Key::from_event(&KeyEvent::new(code, modifiers))
    }

    #[test]
    fn no_key_is_bound_twice() {
        for (index, binding) in BINDINGS.iter().enumerate() {
            for key in binding.keys {
                assert!(
                    BINDINGS[..index]
                        .iter()
                        .all(|before| !before.keys.contains(key)),
                    "{key:?}"
                );
            }
        }
    }

    #[test]
    fn only_the_four_stop_keys_are_always_active_and_no_letter_triggers_them() {
        let always_active: Vec<Action> = BINDINGS
            .iter()
            .filter(|binding| binding.always_active)
            .map(|binding| binding.action)
            .collect();
        assert_eq!(
            always_active,
            [
                Action::Hold,
                Action::Resume,
                Action::Stop,
                Action::Emergency
            ]
        );
        for letter in ('!'..='~').chain('à'..='ÿ') {
            assert_eq!(
                key(KeyCode::Char(letter), KeyModifiers::NONE).always_active_action(),
                None
            );
        }
        // Caps lock does not disable the stop key.
        assert_eq!(
            key(KeyCode::Char('X'), KeyModifiers::CONTROL).always_active_action(),
            Some(Action::Stop)
        );
    }

    #[test]
    fn documentation_contains_this_table() {
        let page = include_str!("../../../../docs/console.md");
        let machine = MachineFile::built_in().unwrap();
        let mut names: Vec<&str> = machine.pose.iter().map(|axis| axis.name.as_str()).collect();
        names.extend(
            ["coordinate 4", "coordinate 5", "coordinate 6"]
                .iter()
                .skip(names.len() - 3),
        );
        let table = markdown(&names);
        assert!(page.contains(&table), "{table}");
    }

    /// Fragments of arrow keys, function keys and answers of the terminal.
    #[test]
    fn fragments_of_a_split_key_sequence_have_no_action() {
        for letter in "[O~;<>0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZu".chars() {
            assert_eq!(
                key(KeyCode::Char(letter), KeyModifiers::NONE).action(),
                None,
                "{letter}"
            );
        }
    }
}
