//! HTML fragments that all pages share.

use std::fmt::{Arguments, Write};

/// Style sheet of all pages.
pub const STYLE: &str = "\
body{font:15px/1.45 system-ui,-apple-system,'Segoe UI',Roboto,sans-serif;color:#1d2733;background:#f5f6f8;margin:0}
main{max-width:1180px;margin:0 auto;padding:28px 20px 60px}
h1{font-size:25px;margin:0 0 2px}h2{font-size:17px;margin:34px 0 8px}
.sub{color:#5b6875;margin:0 0 20px}
.tiles{display:grid;grid-template-columns:repeat(4,1fr);gap:12px}
.tile{background:#fff;border:1px solid #e0e4e9;border-radius:8px;padding:11px 14px}
.tile b{display:block;font-size:21px;font-weight:600;font-variant-numeric:tabular-nums}
.tile span{color:#5b6875;font-size:13px}
.tile.bad,.card.bad{background:#fdecea;border-color:#f1b5ae}
.card{background:#fff;border:1px solid #e0e4e9;border-radius:8px;padding:12px 12px 4px;margin:0 0 14px}
.card p{margin:0 4px 6px;color:#5b6875;font-size:13px}
.pair{display:grid;grid-template-columns:1fr 1fr;gap:14px}
@media(max-width:800px){.tiles{grid-template-columns:1fr 1fr}.pair{grid-template-columns:1fr}}
svg{display:block;width:100%;height:auto}
svg path{fill:none;stroke-linejoin:round;stroke-linecap:round}
svg text{font-size:12px;fill:#3b4754;font-family:inherit}svg .label{fill:#1d2733;font-size:12.5px}
.grid{stroke:#e8ebef;stroke-width:1}.grid.faint{stroke-opacity:.25}.frame{fill:none;stroke:#b9c1ca;stroke-width:1}
table{border-collapse:collapse;background:#fff;border:1px solid #e0e4e9;border-radius:8px;width:100%;font-variant-numeric:tabular-nums}
td{padding:6px 14px;border-bottom:1px solid #eef0f3;vertical-align:top}td:first-child{color:#5b6875;width:40%}
code{font-size:12px;overflow-wrap:anywhere}";

/// Appends formatted text; writing to a string cannot fail.
pub fn put(out: &mut String, text: Arguments<'_>) {
    let _ = out.write_fmt(text);
}

/// Escapes text for HTML.
#[must_use]
pub fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            other => escaped.push(other),
        }
    }
    escaped
}

/// Start of a page up to and including `<main>`; `more_style` follows [`STYLE`].
#[must_use]
pub fn head(title: &str, more_style: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width\"><title>{}</title>\
         <style>{STYLE}{more_style}</style></head><body><main>",
        escape(title)
    )
}

/// End of a page.
pub const END: &str = "</main></body></html>\n";

/// Appends a chart with a caption, which is HTML.
pub fn card(page: &mut String, caption: &str, svg: &str) {
    put(
        page,
        format_args!("<div class=\"card\"><p>{caption}</p>{svg}</div>"),
    );
}
