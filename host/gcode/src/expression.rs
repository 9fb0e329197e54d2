//! Numbers, parameters and expressions of a line.

use super::problem::{Cause, Mistake};

/// Largest magnitude of a number. It keeps all later computations finite.
pub(crate) const LARGEST_NUMBER: f64 = 1e7;

/// Deepest nesting of brackets.
const DEEPEST: u32 = 60;

/// Numbers closer than this are equal for EQ and NE, as in RS274/NGC.
const EQUAL: f64 = 1e-4;

/// Result of reading; an error is boxed because it is rare and large.
pub(crate) type Read<T> = Result<T, Box<Mistake>>;

/// Values of parameters.
pub(crate) trait Values {
    /// Returns a numbered parameter; `None` beyond the largest number.
    fn numbered(&self, number: u32) -> Option<f64>;
    /// Returns a named parameter, its name in lower case without blanks.
    fn named(&self, name: &str) -> Option<f64>;
}

/// A parameter that is assigned to.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Parameter {
    Numbered(u32),
    Named(String),
}

/// A position in a line, with the parameters that its expressions read.
pub(crate) struct Scan<'a> {
    pub bytes: &'a [u8],
    pub at: usize,
    pub values: &'a dyn Values,
    depth: u32,
}

impl<'a> Scan<'a> {
    pub(crate) fn new(bytes: &'a [u8], at: usize, values: &'a dyn Values) -> Self {
        Self {
            bytes,
            at,
            values,
            depth: 0,
        }
    }

    pub(crate) fn peek(&self) -> Option<u8> {
        self.bytes.get(self.at).copied()
    }

    pub(crate) fn skip_blanks(&mut self) {
        while let Some(b' ' | b'\t') = self.peek() {
            self.at += 1;
        }
    }

    pub(crate) fn text(&self, from: usize) -> String {
        text_of(&self.bytes[from..self.at])
    }

    fn eat(&mut self, byte: u8) -> bool {
        self.skip_blanks();
        let found = self.peek() == Some(byte);
        self.at += usize::from(found);
        found
    }

    fn mistake<T>(&self, at: usize, what: impl Into<String>, remedy: &str) -> Read<T> {
        Err(Box::new(Mistake::new(at, what, remedy)))
    }

    /// Whether a value begins here.
    pub(crate) fn has_value(&self) -> bool {
        let digit = |at: usize| {
            self.bytes
                .get(at)
                .is_some_and(|byte| byte.is_ascii_digit() || *byte == b'.')
        };
        match self.peek() {
            Some(b'0'..=b'9' | b'.' | b'[' | b'#') => true,
            Some(b'+' | b'-') => {
                let mut next = self.at + 1;
                while let Some(b' ' | b'\t') = self.bytes.get(next) {
                    next += 1;
                }
                digit(next)
                    || matches!(self.bytes.get(next), Some(b'[' | b'#'))
                    || self.function(next).is_some()
            }
            _ => self.function(self.at).is_some(),
        }
    }

    /// Reads a value: number, parameter, bracket or function, with a sign.
    pub(crate) fn value(&mut self) -> Read<f64> {
        self.skip_blanks();
        let start = self.at;
        match self.peek() {
            Some(b'0'..=b'9' | b'.') => self.number(start),
            Some(sign @ (b'+' | b'-')) => {
                self.at += 1;
                self.skip_blanks();
                let value = match self.peek() {
                    Some(b'0'..=b'9' | b'.') => self.number(start)?,
                    Some(b'+' | b'-') => {
                        return self.mistake(start, "two signs", "write one sign");
                    }
                    _ => self.value()?,
                };
                Ok(if sign == b'-' { -value } else { value })
            }
            Some(b'[') => self.bracket(),
            Some(b'#') => self.parameter_value(),
            _ => match self.function(self.at) {
                Some(name) => self.call(name),
                None => self.mistake(
                    start,
                    "a value is missing",
                    "write a number, a parameter (#1) or an expression in [ ]",
                ),
            },
        }
    }

    /// Reads a number without a sign; `word` is the place of its word, for messages.
    fn number(&mut self, word: usize) -> Read<f64> {
        let start = self.at;
        let (mut mantissa, mut digits, mut decimals) = (0u64, 0u32, 0usize);
        let mut point = false;
        while let Some(byte) = self.peek() {
            match byte {
                b'0'..=b'9' => {
                    if digits < 18 {
                        mantissa = mantissa * 10 + u64::from(byte - b'0');
                    }
                    digits += 1;
                    decimals += usize::from(point);
                }
                b'.' if !point => point = true,
                _ => break,
            }
            self.at += 1;
        }
        if digits == 0 {
            return self.mistake(word, "a number without digits", "write the number");
        }
        const POWERS: [f64; 19] = [
            1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15,
            1e16, 1e17, 1e18,
        ];
        // Both numbers are exact below 2^53, so that the quotient is the nearest f64.
        let value = if digits <= 18 && mantissa < 1 << 53 {
            mantissa as f64 / POWERS[decimals]
        } else {
            std::str::from_utf8(&self.bytes[start..self.at])
                .ok()
                .and_then(|text| text.parse().ok())
                .unwrap_or(f64::INFINITY)
        };
        Ok(value)
    }

    fn enter(&mut self, at: usize) -> Read<()> {
        self.depth += 1;
        if self.depth > DEEPEST {
            return self.mistake(
                at,
                format!("brackets are nested deeper than {DEEPEST}"),
                "divide the expression over parameters",
            );
        }
        Ok(())
    }

    /// Reads an expression in brackets.
    pub(crate) fn bracket(&mut self) -> Read<f64> {
        let open = self.at;
        if !self.eat(b'[') {
            return self.mistake(open, "an expression without [", "write it in [ ]");
        }
        self.enter(open)?;
        let value = self.binary(1)?;
        self.depth -= 1;
        if !self.eat(b']') {
            let at = self.at;
            return match self.peek() {
                None => self.mistake(open, "the bracket [ is not closed", "close it with ]"),
                Some(b'E' | b'e') if self.bytes[..at].last().is_some_and(u8::is_ascii_digit) => {
                    let what = "exponents are not supported";
                    self.mistake(at, what, "write all digits of the number")
                }
                Some(_) => self.mistake(
                    at,
                    "an operator is missing in an expression",
                    "write + - * / ** MOD, EQ NE GT GE LT LE, AND OR XOR, or ]",
                ),
            };
        }
        Ok(value)
    }

    /// Returns the operator here, with its length and precedence.
    fn operator(&mut self) -> Option<(Operator, usize, u8)> {
        self.skip_blanks();
        let rest = &self.bytes[self.at..];
        let first = rest.first()?;
        Some(match first {
            b'+' => (Operator::Add, 1, 3),
            b'-' => (Operator::Subtract, 1, 3),
            b'*' if rest.get(1) == Some(&b'*') => (Operator::Power, 2, 5),
            b'*' => (Operator::Multiply, 1, 4),
            b'/' => (Operator::Divide, 1, 4),
            byte if byte.is_ascii_alphabetic() => {
                return OPERATORS.iter().find_map(|(name, operator, precedence)| {
                    let part = rest.get(..name.len())?;
                    part.eq_ignore_ascii_case(name.as_bytes()).then_some((
                        *operator,
                        name.len(),
                        *precedence,
                    ))
                });
            }
            _ => return None,
        })
    }

    /// Reads operands and operators of at least `lowest` precedence; all associate to the left.
    fn binary(&mut self, lowest: u8) -> Read<f64> {
        let mut left = self.value()?;
        while let Some((operator, length, precedence)) = self.operator() {
            if precedence < lowest {
                break;
            }
            let at = self.at;
            self.at += length;
            let right = self.binary(precedence + 1)?;
            left = self.apply(operator, left, right, at)?;
        }
        Ok(left)
    }

    fn apply(&self, operator: Operator, left: f64, right: f64, at: usize) -> Read<f64> {
        let truth = |value: bool| f64::from(u8::from(value));
        let value = match operator {
            Operator::Add => left + right,
            Operator::Subtract => left - right,
            Operator::Multiply => left * right,
            Operator::Divide | Operator::Modulo if right == 0.0 => {
                return self.mistake(at, "a division by zero", "check the divisor");
            }
            Operator::Divide => left / right,
            Operator::Modulo => {
                let rest = libm::fmod(left, right);
                if rest < 0.0 { rest + right.abs() } else { rest }
            }
            Operator::Power => {
                if left < 0.0 && right.fract() != 0.0 {
                    return self.mistake(
                        at,
                        "a fractional power of a negative number",
                        "check the base",
                    );
                }
                libm::pow(left, right)
            }
            Operator::Equal => truth((left - right).abs() < EQUAL),
            Operator::NotEqual => truth((left - right).abs() >= EQUAL),
            Operator::Greater => truth(left > right),
            Operator::GreaterOrEqual => truth(left >= right),
            Operator::Less => truth(left < right),
            Operator::LessOrEqual => truth(left <= right),
            Operator::And => truth(left != 0.0 && right != 0.0),
            Operator::Or => truth(left != 0.0 || right != 0.0),
            Operator::ExclusiveOr => truth((left != 0.0) != (right != 0.0)),
        };
        self.finite(value, at)
    }

    /// A NaN is the value of a parameter whose assignment was refused; it stays a NaN.
    fn finite(&self, value: f64, at: usize) -> Read<f64> {
        if value.is_infinite() {
            return self.mistake(at, "the result is too large", "check the expression");
        }
        Ok(value)
    }

    /// Returns the name of the function at `at`: letters before `[`.
    fn function(&self, at: usize) -> Option<Function> {
        let rest = self.bytes.get(at..)?;
        if !rest.first()?.is_ascii_alphabetic() {
            return None;
        }
        FUNCTIONS.iter().find_map(|(name, function)| {
            let part = rest.get(..name.len())?;
            if !part.eq_ignore_ascii_case(name.as_bytes()) {
                return None;
            }
            let next = rest[name.len()..]
                .iter()
                .find(|byte| !matches!(byte, b' ' | b'\t'));
            (next == Some(&b'[')).then_some(*function)
        })
    }

    fn call(&mut self, function: Function) -> Read<f64> {
        let start = self.at;
        let name = FUNCTIONS
            .iter()
            .find(|(_, known)| *known == function)
            .map_or("", |(name, _)| name);
        self.at += name.len();
        self.skip_blanks();
        if function == Function::Exists {
            return self.exists();
        }
        let x = self.bracket()?;
        let domain = |scan: &Self, limits: &str| {
            scan.mistake(
                start,
                format!("{name}[{x}] does not exist"),
                &format!("its argument must be {limits}"),
            )
        };
        let value = match function {
            Function::Abs => x.abs(),
            Function::Acos if x.abs() > 1.0 => return domain(self, "from -1 to 1"),
            Function::Asin if x.abs() > 1.0 => return domain(self, "from -1 to 1"),
            Function::Acos => libm::acos(x).to_degrees(),
            Function::Asin => libm::asin(x).to_degrees(),
            Function::Atan => {
                let at = self.at;
                if !self.eat(b'/') {
                    return self.mistake(
                        at,
                        "ATAN without its second argument",
                        "write ATAN[y]/[x]",
                    );
                }
                let below = self.value()?;
                libm::atan2(x, below).to_degrees()
            }
            Function::Cos => libm::cos(radians(x)),
            Function::Sin => libm::sin(radians(x)),
            Function::Tan => libm::tan(radians(x)),
            Function::Exp => libm::exp(x),
            Function::Fix => x.floor(),
            Function::Fup => x.ceil(),
            Function::Round => libm::round(x),
            Function::Ln if x <= 0.0 => return domain(self, "above 0"),
            Function::Ln => libm::log(x),
            Function::Sqrt if x < 0.0 => return domain(self, "from 0"),
            Function::Sqrt => libm::sqrt(x),
            Function::Exists => x,
        };
        self.finite(value, start)
    }

    fn exists(&mut self) -> Read<f64> {
        let at = self.at;
        self.eat(b'[');
        let found = match self.parameter()? {
            Parameter::Named(name) => self.values.named(&name).is_some(),
            Parameter::Numbered(number) => self.values.numbered(number).is_some(),
        };
        if !self.eat(b']') {
            return self.mistake(
                at,
                "EXISTS has more than a parameter in its bracket",
                "write EXISTS[#<name>]",
            );
        }
        Ok(f64::from(u8::from(found)))
    }

    /// Reads a parameter: `#5`, `#[1+4]`, `##2`, `#<name>`.
    pub(crate) fn parameter(&mut self) -> Read<Parameter> {
        let start = self.at;
        if !self.eat(b'#') {
            return self.mistake(start, "a parameter is missing", "write #1 or #<name>");
        }
        self.skip_blanks();
        if self.peek() == Some(b'<') {
            self.at += 1;
            return Ok(Parameter::Named(self.name(start)?));
        }
        self.enter(start)?;
        let value = self.value()?;
        self.depth -= 1;
        let number = libm::round(value);
        if !((number - value).abs() < EQUAL && (0.0..=f64::from(u32::MAX)).contains(&number)) {
            return self.mistake(
                start,
                format!("#{value} is not a parameter"),
                "parameters have whole numbers from 1 to 5602",
            );
        }
        Ok(Parameter::Numbered(number as u32))
    }

    /// Reads a name up to `>`, after its `<`; `start` is the place of the parameter or label.
    pub(crate) fn name(&mut self, start: usize) -> Read<String> {
        let from = self.at;
        let Some(length) = self.bytes[from..].iter().position(|&byte| byte == b'>') else {
            return self.mistake(start, "a name is not closed", "close it with >");
        };
        self.at = from + length + 1;
        let bytes = &self.bytes[from..from + length];
        let name: String = String::from_utf8_lossy(bytes)
            .chars()
            .filter(|letter| !letter.is_whitespace())
            .flat_map(char::to_lowercase)
            .collect();
        if name.is_empty() || name.len() > 200 {
            return self.mistake(
                start,
                "a parameter name of no letters, or of more than 200",
                "write 1 to 200 letters",
            );
        }
        Ok(name)
    }

    fn parameter_value(&mut self) -> Read<f64> {
        let start = self.at;
        let (value, remedy) = match self.parameter()? {
            Parameter::Numbered(number) => (
                self.values.numbered(number),
                "parameters have the numbers 1 to 5602",
            ),
            Parameter::Named(name) => (
                self.values.named(&name),
                "assign a value before: #<name> = 1",
            ),
        };
        match value {
            Some(value) => Ok(value),
            None => {
                let what = format!("the parameter {} has no value", self.text(start));
                Err(Box::new(
                    Mistake::new(start, what, remedy).because(Cause::Parameter),
                ))
            }
        }
    }
}

/// Returns the text of bytes, those that are not UTF-8 replaced.
pub(crate) fn text_of(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).trim().to_owned()
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Operator {
    Add,
    Subtract,
    Multiply,
    Divide,
    Modulo,
    Power,
    Equal,
    NotEqual,
    Greater,
    GreaterOrEqual,
    Less,
    LessOrEqual,
    And,
    Or,
    ExclusiveOr,
}

const OPERATORS: [(&str, Operator, u8); 10] = [
    ("AND", Operator::And, 1),
    ("XOR", Operator::ExclusiveOr, 1),
    ("OR", Operator::Or, 1),
    ("EQ", Operator::Equal, 2),
    ("NE", Operator::NotEqual, 2),
    ("GT", Operator::Greater, 2),
    ("GE", Operator::GreaterOrEqual, 2),
    ("LT", Operator::Less, 2),
    ("LE", Operator::LessOrEqual, 2),
    ("MOD", Operator::Modulo, 4),
];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Function {
    Abs,
    Acos,
    Asin,
    Atan,
    Cos,
    Exists,
    Exp,
    Fix,
    Fup,
    Ln,
    Round,
    Sin,
    Sqrt,
    Tan,
}

const FUNCTIONS: [(&str, Function); 14] = [
    ("ABS", Function::Abs),
    ("ACOS", Function::Acos),
    ("ASIN", Function::Asin),
    ("ATAN", Function::Atan),
    ("COS", Function::Cos),
    ("EXISTS", Function::Exists),
    ("EXP", Function::Exp),
    ("FIX", Function::Fix),
    ("FUP", Function::Fup),
    ("LN", Function::Ln),
    ("ROUND", Function::Round),
    ("SIN", Function::Sin),
    ("SQRT", Function::Sqrt),
    ("TAN", Function::Tan),
];

/// Returns an angle in radians, rounded once: sin of 30 degrees is 0.5, as FIX and ROUND of a
/// multiple of it need.
fn radians(degrees: f64) -> f64 {
    // pi / 180, and what its rounding left out.
    const RADIANS: f64 = std::f64::consts::PI / 180.0;
    const REST: f64 = 2.948_652_270_870_168_7e-19;
    libm::fma(degrees, RADIANS, degrees * REST)
}
