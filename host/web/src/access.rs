//! Who is served: the headers `Host` and `Origin`, and the token.

use std::net::SocketAddr;

/// Head of a request: method, target and headers.
#[derive(Debug, Default)]
pub struct Head {
    /// `GET`.
    pub method: String,
    /// Path and query.
    pub target: String,
    /// Names in lower case, and values.
    pub headers: Vec<(String, String)>,
}

impl Head {
    /// Reads the text of a head, up to the empty line.
    ///
    /// # Errors
    /// It is no HTTP/1.1.
    pub fn parse(text: &str) -> Result<Self, &'static str> {
        let mut lines = text.split("\r\n");
        let mut words = lines.next().unwrap_or_default().split(' ');
        let (Some(method), Some(target), Some("HTTP/1.1"), None) =
            (words.next(), words.next(), words.next(), words.next())
        else {
            return Err("write METHOD TARGET HTTP/1.1");
        };
        if !target.starts_with('/') {
            return Err("the target must be a path");
        }
        let headers = lines.take_while(|line| !line.is_empty()).map(|line| {
            let (name, value) = line.split_once(':').ok_or("a header has no colon")?;
            if name.is_empty() || name.contains([' ', '\t']) {
                return Err("a header has no valid name");
            }
            Ok((name.to_ascii_lowercase(), value.trim().to_string()))
        });
        Ok(Self {
            method: method.to_string(),
            target: target.to_string(),
            headers: headers.collect::<Result<_, _>>()?,
        })
    }

    /// The only header of a name; none where it is missing or there several times.
    #[must_use]
    pub fn only(&self, name: &str) -> Option<&str> {
        let mut values = self.headers.iter().filter(|(key, _)| key == name);
        match (values.next(), values.next()) {
            (Some((_, value)), None) => Some(value),
            _ => None,
        }
    }

    /// The path, without query.
    #[must_use]
    pub fn path(&self) -> &str {
        self.target.split('?').next().unwrap_or_default()
    }

    /// The token in the query.
    #[must_use]
    pub fn token(&self) -> Option<&str> {
        let (_, query) = self.target.split_once('?')?;
        query
            .split('&')
            .find_map(|pair| pair.strip_prefix("token="))
    }
}

/// Checks that a request names the address at which it arrived. A name that somebody else made to
/// resolve to this address is another host.
///
/// # Errors
/// What the header says.
pub fn check_host(head: &Head, local: SocketAddr) -> Result<&str, String> {
    let host = head.only("host").ok_or("there is not one Host header")?;
    let local = SocketAddr::new(local.ip().to_canonical(), local.port());
    let is_served = |host: &str| {
        host == local.to_string()
            || local.ip().is_loopback() && host == format!("localhost:{}", local.port())
    };
    // A browser leaves out the port 80.
    let full = match host.rsplit_once(':') {
        Some((_, port)) if !port.ends_with(']') => host.to_ascii_lowercase(),
        _ => format!("{}:80", host.to_ascii_lowercase()),
    };
    if is_served(&full) {
        return Ok(host);
    }
    Err(format!(
        "Host {host:?} is not the served address {local}; open http://{local}/"
    ))
}

/// Checks that the page of a request is the served one.
///
/// # Errors
/// What the header says.
pub fn check_origin(head: &Head, host: &str) -> Result<(), String> {
    match head.only("origin") {
        Some(origin) if origin.eq_ignore_ascii_case(&format!("http://{host}")) => Ok(()),
        Some(origin) => Err(format!("the page {origin:?} is not the served page")),
        None => Err("there is not one Origin header".to_string()),
    }
}

/// Checks the token, in a time that does not depend on where it differs.
///
/// # Errors
/// It is missing or wrong.
pub fn check_token(head: &Head, token: Option<&str>) -> Result<(), String> {
    let Some(token) = token else { return Ok(()) };
    let given = head.token().ok_or("the token is missing")?;
    let differs = given
        .bytes()
        .zip(token.bytes())
        .fold(0, |sum, (a, b)| sum | (a ^ b));
    if given.len() == token.len() && differs == 0 {
        return Ok(());
    }
    Err("the token is wrong".to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn head(host: &str) -> Head {
        Head::parse(&format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n")).unwrap()
    }

    #[test]
    fn only_the_served_address_is_a_host() {
        let local = "127.0.0.1:8765".parse().unwrap();
        for good in ["127.0.0.1:8765", "localhost:8765", "LocalHost:8765"] {
            assert_eq!(check_host(&head(good), local), Ok(good));
        }
        for bad in [
            "evil.test:8765",
            "127.0.0.1",
            "127.0.0.1:80",
            "",
            "localhost.evil.test:8765",
        ] {
            assert!(check_host(&head(bad), local).is_err(), "{bad}");
        }
        let lan = "192.0.2.7:80".parse().unwrap();
        assert!(check_host(&head("192.0.2.7"), lan).is_ok());
        assert!(check_host(&head("localhost"), lan).is_err());
        let six = "[::1]:8765".parse().unwrap();
        assert!(check_host(&head("[::1]:8765"), six).is_ok());
        let mapped = "[::ffff:192.0.2.7]:8765".parse().unwrap();
        assert!(check_host(&head("192.0.2.7:8765"), mapped).is_ok());
        let twice = "GET / HTTP/1.1\r\nHost: localhost:8765\r\nHost: localhost:8765\r\n\r\n";
        assert!(check_host(&Head::parse(twice).unwrap(), local).is_err());
    }

    #[test]
    fn a_token_must_be_whole() {
        let with = |query: &str| Head::parse(&format!("GET /ws{query} HTTP/1.1\r\n\r\n")).unwrap();
        assert!(check_token(&with(""), None).is_ok());
        assert!(check_token(&with("?token=abcd"), Some("abcd")).is_ok());
        for bad in [
            "",
            "?token=",
            "?token=abc",
            "?token=abcde",
            "?token=abce",
            "?Token=abcd",
        ] {
            assert!(check_token(&with(bad), Some("abcd")).is_err(), "{bad}");
        }
    }
}
