//! Keys: what each of them does, in one table from which the help, the documentation and the console itself are made.
//!
//! Four keys are heard always, whatever is open on the screen, while a name is typed and while the link is down: hold, resume, stop, emergency stop.
//! None of them is a letter alone, so nothing that is typed can be mistaken for one.
//!
//! A key that a terminal sends as several bytes may arrive torn apart over a slow line: Escape, then `[`, digits, capital letters, `~`. None of these
//! does anything that could not be taken back, and Escape itself holds.

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

/// What a key asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Whatever moves slows down; a job keeps its place.
    Hold,
    /// The job goes on.
    Resume,
    /// Whatever moves slows down; a job is dropped.
    Stop,
    /// Drives off.
    Emergency,
    /// End the console.
    Quit,
    /// Drives on.
    Enable,
    /// Drives off from standstill.
    Disable,
    /// Find the references.
    Home,
    /// Clear a latched fault.
    Reset,
    /// Move a pose coordinate.
    Jog {
        /// Index of the coordinate.
        axis: u8,
        /// Upwards.
        up: bool,
    },
    /// Continuous jog or steps.
    Mode,
    /// A slower jog, or a smaller step.
    Decrease,
    /// A faster jog, or a larger step.
    Increase,
    /// More feed override.
    OverrideUp,
    /// Less feed override.
    OverrideDown,
    /// Choose a part program.
    Program,
    /// Choose the source of each axis.
    Axes,
    /// Force loop.
    Force,
    /// The hand on a haptic arm.
    Master,
    /// New zero of the force sensor.
    Tare,
    /// Recording on or off.
    Record,
    /// The table of keys.
    Help,
    /// Nothing, or leave what is open.
    Close,
}

/// A key, as a terminal tells it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Key {
    /// Which.
    pub code: KeyCode,
    /// With Ctrl held.
    pub control: bool,
}

/// A row of the table.
#[derive(Debug, Clone, Copy)]
pub struct Binding {
    /// The keys, any of them.
    pub keys: &'static [Key],
    /// How people call them.
    pub name: &'static str,
    /// What they ask for.
    pub action: Action,
    /// In words.
    pub what: &'static str,
    /// Heard in every overlay and while typing.
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
    what: &'static str,
) -> Binding {
    Binding {
        always_active: true,
        ..binding_for(keys, name, action, what)
    }
}

const fn binding_for(
    keys: &'static [Key],
    name: &'static str,
    action: Action,
    what: &'static str,
) -> Binding {
    Binding {
        keys,
        name,
        action,
        what,
        always_active: false,
    }
}

const fn jog(axis: u8, up: bool) -> Action {
    Action::Jog { axis, up }
}

/// All keys. A jog key belongs to the pose coordinate of its index; its name in the table is that of the H-4 arm.
pub const BINDINGS: &[Binding] = &[
    always_active(
        &[plain(' '), special(KeyCode::F(5))],
        "Space, F5",
        Action::Hold,
        "hold: what moves slows down, a program keeps its place, a jog or homing ends",
    ),
    always_active(
        &[control('r'), special(KeyCode::F(6))],
        "Ctrl-R, F6",
        Action::Resume,
        "resume after a hold or a pause of the program",
    ),
    always_active(
        &[control('x'), special(KeyCode::F(7))],
        "Ctrl-X, F7",
        Action::Stop,
        "stop: slow down along the path and drop the program; the position is kept",
    ),
    always_active(
        &[control('e'), special(KeyCode::F(8))],
        "Ctrl-E, F8",
        Action::Emergency,
        "emergency stop: drives off at once, latched until reset",
    ),
    binding_for(
        &[special(KeyCode::Right)],
        "Right",
        jog(0, true),
        "jog x up",
    ),
    binding_for(
        &[special(KeyCode::Left)],
        "Left",
        jog(0, false),
        "jog x down",
    ),
    binding_for(&[special(KeyCode::Up)], "Up", jog(1, true), "jog y up"),
    binding_for(
        &[special(KeyCode::Down)],
        "Down",
        jog(1, false),
        "jog y down",
    ),
    binding_for(
        &[special(KeyCode::PageUp)],
        "PageUp",
        jog(2, true),
        "jog z up",
    ),
    binding_for(
        &[special(KeyCode::PageDown)],
        "PageDown",
        jog(2, false),
        "jog z down",
    ),
    binding_for(
        &[plain('.')],
        ".",
        jog(3, true),
        "jog theta (tilt of the tool) up",
    ),
    binding_for(&[plain(',')], ",", jog(3, false), "jog theta down"),
    binding_for(
        &[plain('m')],
        "m",
        jog(4, true),
        "jog alpha (turn of the table) up",
    ),
    binding_for(&[plain('n')], "n", jog(4, false), "jog alpha down"),
    binding_for(
        &[plain('k')],
        "k",
        jog(5, true),
        "jog the sixth axis up, where there is one",
    ),
    binding_for(&[plain('j')], "j", jog(5, false), "jog the sixth axis down"),
    binding_for(
        &[special(KeyCode::Tab)],
        "Tab",
        Action::Mode,
        "continuous jog, or one step for each press",
    ),
    binding_for(
        &[plain('f')],
        "f",
        Action::Increase,
        "faster jog; in steps, the next larger step",
    ),
    binding_for(
        &[plain('s')],
        "s",
        Action::Decrease,
        "slower jog; in steps, the next smaller step",
    ),
    binding_for(&[plain('e')], "e", Action::Enable, "enable: drives on"),
    binding_for(
        &[plain('d')],
        "d",
        Action::Disable,
        "disable: drives off, from standstill",
    ),
    binding_for(
        &[plain('h')],
        "h",
        Action::Home,
        "home: find the references, then go to the home pose (asks first)",
    ),
    binding_for(
        &[plain('x')],
        "x",
        Action::Reset,
        "reset a latched fault or emergency stop",
    ),
    binding_for(
        &[plain('p')],
        "p",
        Action::Program,
        "part program: choose, check, run (asks first)",
    ),
    binding_for(
        &[plain('+'), plain('=')],
        "+",
        Action::OverrideUp,
        "more feed override",
    ),
    binding_for(
        &[plain('-')],
        "-",
        Action::OverrideDown,
        "less feed override",
    ),
    binding_for(
        &[plain('a')],
        "a",
        Action::Axes,
        "axes: each led by the program, held, or jogged",
    ),
    binding_for(
        &[plain('y')],
        "y",
        Action::Force,
        "force loop: which axes yield, and above which force",
    ),
    binding_for(
        &[plain('w')],
        "w",
        Action::Master,
        "hand: what it feels, reflection, virtual walls, position scale",
    ),
    binding_for(
        &[plain('t')],
        "t",
        Action::Tare,
        "tare: what the force sensor shows now is none (asks first)",
    ),
    binding_for(
        &[plain('l')],
        "l",
        Action::Record,
        "log: recording on or off",
    ),
    binding_for(
        &[plain('?'), special(KeyCode::F(1))],
        "?, F1",
        Action::Help,
        "this table",
    ),
    binding_for(
        &[plain('q'), control('c')],
        "q, Ctrl-C",
        Action::Quit,
        "quit (asks first when drives are on)",
    ),
    binding_for(
        &[special(KeyCode::Esc)],
        "Esc",
        Action::Close,
        "close what is open; with nothing open, hold",
    ),
];

impl Key {
    /// The key of an event. Capital letters are not small ones, except with Ctrl.
    #[must_use]
    pub fn of(event: &KeyEvent) -> Self {
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

    /// What the key asks for when nothing is open.
    #[must_use]
    pub fn action(self) -> Option<Action> {
        self.binding().map(|binding| binding.action)
    }

    /// What the key asks for whatever is open.
    #[must_use]
    pub fn always_active(self) -> Option<Action> {
        self.binding()
            .filter(|binding| binding.always_active)
            .map(|binding| binding.action)
    }
}

/// The table in Markdown, as docs/console.md has it.
#[must_use]
pub fn markdown() -> String {
    let rows: String = BINDINGS
        .iter()
        .map(|row| {
            let mark = if row.always_active {
                ", always heard"
            } else {
                ""
            };
            format!("| {} | {}{mark} |\n", row.name, row.what)
        })
        .collect();
    format!("| key | what it does |\n| --- | --- |\n{rows}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(code: KeyCode, modifiers: KeyModifiers) -> Key {
        Key::of(&KeyEvent::new(code, modifiers))
    }

    #[test]
    fn no_key_has_two_meanings() {
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
    fn the_four_are_heard_always_and_nothing_that_is_typed_is_one_of_them() {
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
                key(KeyCode::Char(letter), KeyModifiers::NONE).always_active(),
                None
            );
        }
        // Caps lock takes nothing away from a stop.
        assert_eq!(
            key(KeyCode::Char('X'), KeyModifiers::CONTROL).always_active(),
            Some(Action::Stop)
        );
    }

    #[test]
    fn the_documentation_has_this_table() {
        let page = include_str!("../../../../docs/console.md");
        assert!(page.contains(&markdown()), "{}", markdown());
    }

    /// A torn escape sequence leaves these; of arrows, function keys, and answers of the terminal.
    #[test]
    fn what_is_left_of_a_torn_key_does_nothing() {
        for letter in "[O~;<>0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZu".chars() {
            assert_eq!(
                key(KeyCode::Char(letter), KeyModifiers::NONE).action(),
                None,
                "{letter}"
            );
        }
    }
}
