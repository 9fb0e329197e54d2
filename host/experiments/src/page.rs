//! HTML pages: one for each experiment with the charts of the thesis's figures, and an index.

mod charts;
mod row_charts;

use super::comparison::Comparison;
use super::table::{band, counts, value, verdict};
use super::{Experiment, ExperimentResult, PassData};
use haptimill_report::markup::{END, escape, head, put};

const MORE_STYLE: &str = "
th{text-align:left;padding:7px 14px;border-bottom:1px solid #d5dae0;font-weight:600;color:#3b4754;font-size:13px}
table.results td{padding:6px 14px}table.results td:first-child{color:#1d2733;width:auto}table.results td:nth-child(2){min-width:5em}
td.n{white-space:nowrap}tr.out td{background:#fdf3e7}tr.charts .card{margin:4px 0}table.results tr.charts td{padding:4px 6px}
.in{color:#00704a;font-weight:600}.outside{color:#b04a00;font-weight:600}.why{display:block;color:#5b6875;font-size:13px;max-width:720px}
.source{color:#7a8691;font-size:12px}h3{font-size:15px;margin:20px 0 8px;color:#3b4754}
a{color:#0060a0;text-decoration:none}a:hover{text-decoration:underline}
.depth{display:inline-block;width:120px;height:10px;margin:0 6px;vertical-align:middle;border:1px solid #b9c1ca}";

/// Width of one surface image, and of each of several side by side, in pixels.
const WIDE: f64 = 1038.0;
const NARROW: f64 = 440.0;

/// The page of an experiment.
#[must_use]
pub fn page(experiment: &Experiment, data: &[PassData], result: &ExperimentResult) -> String {
    let name = experiment.name.to_uppercase();
    let title = format!("{name}: {}", experiment.title);
    let mut page = head(&title, MORE_STYLE);
    put(
        &mut page,
        format_args!(
            "<p class=\"sub\" style=\"margin:0\"><a href=\"../index.html\">all experiments</a></p>\
             <h1>{}</h1><p class=\"sub\">{} Thesis: {}.</p>",
            escape(&title),
            escape(&experiment.setting),
            escape(&experiment.figures)
        ),
    );
    comparisons(&mut page, experiment, data, result);
    // A single pass has these curves among its own charts.
    if experiment.needs_force_control() && data.len() > 1 {
        charts::compliance(&mut page, experiment, data);
    }
    let passes = || experiment.passes.iter().zip(data);
    let cutting = || passes().filter(|(pass, _)| pass.has_cutting());
    let (class, width) = match data {
        [_] => ("", WIDE),
        _ => (" class=\"pair\"", NARROW),
    };
    put(&mut page, format_args!("<div{class}>"));
    for (pass, data) in cutting() {
        page.push_str("<div>");
        charts::surface(&mut page, data, &pass.title, width);
        page.push_str("</div>");
    }
    page.push_str("</div>");
    for (pass, data) in passes() {
        charts::teleoperation(&mut page, pass, data);
    }
    for (pass, data) in cutting() {
        charts::pass(&mut page, pass, data);
    }
    passes_table(&mut page, result);
    page.push_str(END);
    page
}

fn comparisons(
    page: &mut String,
    experiment: &Experiment,
    data: &[PassData],
    result: &ExperimentResult,
) {
    put(
        page,
        format_args!(
            "<h2>Results of the thesis and of the simulator: {} of {} inside their bands</h2>\
             <table class=\"results\"><tr><th>result</th><th>thesis</th><th>band</th>\
             <th>simulated</th><th></th></tr>",
            result.inside(),
            result.comparisons.len()
        ),
    );
    let rows = result.comparisons.iter().zip(&experiment.expected);
    for (number, (comparison, expected)) in (1..).zip(rows) {
        comparison_row(page, comparison);
        if !comparison.is_inside {
            row_charts::row(page, experiment, data, expected, number);
        }
    }
    page.push_str(
        "</table><p class=\"sub\" style=\"margin:8px 2px\">Bands: <i>stated</i> by the thesis; \
         <i>derived</i> from its numbers; <i>own</i>: a requirement of this project; \
         <i>input</i>: the pace of the operator was chosen for it. Below a result \
         outside its band: the measured quantity in the window of the result (grey beside it) with \
         the band, the value of the thesis where it states one, and the simulated value; beside it the cause.</p>",
    );
}

fn comparison_row(page: &mut String, comparison: &Comparison) {
    let (row, class) = if comparison.is_inside {
        ("", "in")
    } else {
        (" class=\"out\"", "outside")
    };
    let reason = comparison.reason.as_ref().map_or(String::new(), |reason| {
        format!("<span class=\"why\">{}</span>", escape(reason))
    });
    let thesis = match comparison.thesis.as_str() {
        "" => "<span class=\"source\">not stated</span>".to_string(),
        thesis => escape(thesis),
    };
    let band = band(&comparison.band, &comparison.unit);
    let (band, source) = band.rsplit_once(" (").unwrap_or((&band, ""));
    let input = if comparison.is_input { ", input" } else { "" };
    put(
        page,
        format_args!(
            "<tr{row}><td>{}{reason}</td><td>{thesis}</td>\
             <td class=\"n\">{} <span class=\"source\">{}{input}</span></td>\
             <td class=\"n\">{} {}</td><td class=\"n {class}\">{}</td></tr>",
            escape(&comparison.name),
            escape(band),
            source.trim_end_matches(')'),
            value(comparison.simulated),
            comparison.unit,
            verdict(comparison).to_lowercase(),
        ),
    );
}

fn passes_table(page: &mut String, result: &ExperimentResult) {
    page.push_str(
        "<h2>Passes</h2><table class=\"results\"><tr><th>pass</th><th>program, stock</th>\
         <th>force control</th>\
         <th>origin of the forces</th><th>files</th></tr>",
    );
    for pass in &result.passes {
        let control = pass.force_control.as_ref();
        let control = control.map_or("none".to_string(), |control| {
            let axes: Vec<String> = control.axes.iter().map(|a| format!("{a:?}")).collect();
            format!(
                "{}; f_d {} N, K_A {}, K_V {}",
                axes.join(", "),
                control.setpoint_n,
                control.virtual_mass,
                control.virtual_damping
            )
        });
        put(
            page,
            format_args!(
                "<tr><td class=\"n\">{0}</td><td>{1}, {2}</td>\
                 <td class=\"n\">{control}</td><td>{3}</td>\
                 <td class=\"n\"><a href=\"{0}/report.html\">report</a> \
                 <a href=\"{0}/trace.csv\">trace</a></td></tr>",
                pass.name,
                pass.program,
                pass.stock,
                pass.forces.description(),
            ),
        );
    }
    page.push_str("</table>");
}

/// The index of all experiments.
#[must_use]
pub fn index(machine: &str, results: &[ExperimentResult]) -> String {
    let mut page = head("Experiments", MORE_STYLE);
    let counts = counts(results);
    let counts: Vec<String> = counts.lines().map(escape).collect();
    put(
        &mut page,
        format_args!(
            "<h1>The experiments of the thesis in the simulator</h1><p class=\"sub\">Machine: {}. \
             All experiments use one plant and one set of cutting parameters. Results inside their \
             bands, by the source of the band:<br>{}</p>",
            escape(machine),
            counts.join("<br>")
        ),
    );
    page.push_str(
        "<table class=\"results\"><tr><th></th><th>experiment</th><th>inside</th>\
         <th>outside</th></tr>",
    );
    for result in results {
        let name = result.name.to_uppercase();
        let title = escape(&result.title);
        if let Some(reason) = &result.not_run {
            put(
                &mut page,
                format_args!(
                    "<tr class=\"out\"><td>{name}</td><td>{title}</td>\
                     <td colspan=\"2\" class=\"outside\">not run: {}</td></tr>",
                    escape(reason)
                ),
            );
            continue;
        }
        let outside = result.comparisons.iter().filter(|result| !result.is_inside);
        let outside: Vec<String> = outside
            .map(|result| {
                format!(
                    "{}: {} {}, band {}",
                    escape(&result.name),
                    value(result.simulated),
                    result.unit,
                    escape(&band(&result.band, &result.unit))
                )
            })
            .collect();
        put(
            &mut page,
            format_args!(
                "<tr><td><a href=\"{0}/index.html\">{name}</a></td>\
                 <td><a href=\"{0}/index.html\">{title}</a></td>\
                 <td class=\"n\">{1} of {2}</td><td>{3}</td></tr>",
                result.name,
                result.inside(),
                result.comparisons.len(),
                outside.join("<br>")
            ),
        );
    }
    page.push_str("</table>");
    page.push_str(END);
    page
}
