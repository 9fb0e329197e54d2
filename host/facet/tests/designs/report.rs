//! The report of a stone: what a cutter reads of the design.

use super::{SMALL, example, gem};
use haptimill_facet::{Cutting, Gem, Job, JobSettings, Measured, Stage, read, report};

/// The report of a stone without errors.
fn page(gem: &Gem) -> String {
    let stone = gem.body.clone();
    let cutting = Cutting {
        measured: Measured::new(gem, &stone, &[]),
        stone,
        ground: Vec::new(),
        operations: Vec::new(),
        wear: Vec::new(),
        stopped: None,
    };
    let job = Job::new(gem, JobSettings::default()).unwrap();
    report(gem, &job, &cutting, None)
}

/// The cutting table has every tier with its angle, positions and note, as the file has them.
#[test]
fn the_report_has_the_cutting_table_of_the_design() {
    let name = "round-brilliant.asc";
    let page = page(&gem(name));
    let text = String::from_utf8(example(name)).unwrap();
    let (_, table) = page.split_once("<h2>Cutting table</h2>").unwrap();
    let (table, _) = table.split_once("</table>").unwrap();
    let table = table.replace("<wbr>", "");
    let mut rows: Vec<&str> = table.split("<tr><td>").skip(1).collect();
    for line in text.lines().filter(|line| line.starts_with("a ")) {
        let (facets, note) = line.split_once(" G ").unwrap();
        let words: Vec<&str> = facets.split(' ').collect();
        let angle: f64 = words[1].parse().unwrap();
        let name = words[words.iter().position(|word| *word == "n").unwrap() + 1];
        let indices = words[3..].iter().filter(|word| word.parse::<f64>().is_ok());
        let indices: Vec<&str> = indices.copied().collect();
        let row = rows.remove(0);
        let row = row.split("<tr>").next().unwrap();
        let cells: Vec<&str> = row.split("<td>").collect();
        assert_eq!(cells[0], name);
        assert_eq!(cells[2], format!("{:.2}", angle.abs()));
        assert_eq!(cells[3], indices.join("-"));
        assert_eq!(cells[4], note);
    }
    assert!(rows.is_empty(), "{rows:?}");
    assert_eq!(table.matches("the stone is turned over before").count(), 1);
    for expected in [
        "<p class=remark>Angles for quartz</p>",
        "<p class=remark>Designed for this project from the equations of its meet points</p>",
        "<b>57 + 16</b>facets, on the girdle",
        "<b>96</b>index wheel</div>",
        "<b>1.54</b>refractive index",
        "<b>8-fold, mirror-image</b>symmetry",
    ] {
        assert!(page.contains(expected), "{expected}");
    }
    // It is offline: the only address is the name of SVG.
    let page = page.replace("http://www.w3.org/2000/svg", "");
    assert!(!page.contains("http:") && !page.contains("https:"));
}

/// A list with a row for each facet has one row for each tier, and no text of it is markup.
#[test]
fn rows_of_a_list_are_tiers() {
    let text = "# gear = 64\nangle,index,depth,name,note\n-90,0,1.25,<G>,a & b\n\
                -90,16,1.25,<G>,a & b\n-90,32,1.25,<G>,a & b\n-90,48,1.25,<G>,a & b\n\
                -0,0,0.9,P,\ntransfer\n0,0,0.375,T,\n";
    let design = read("a.csv", text.as_bytes()).unwrap();
    let tiers = design.tiers();
    let names: Vec<&str> = tiers.iter().map(|tier| tier.name.as_str()).collect();
    assert_eq!(names, ["<G>", "P", "T"]);
    assert_eq!(tiers[0].index_text(), "0-16-32-48");
    assert_eq!(tiers[2].facets, [5]);
    let page = page(&Gem::new("a.csv", design, 2.5, None).unwrap());
    assert!(
        page.contains("<td>&lt;G&gt;<td>girdle<td>90.00<td>0-<wbr>16-<wbr>32-<wbr>48<td>a &amp; b")
    );
    assert!(!page.contains("<G>"));
}

/// The pictures show each facet that faces the eye, at its corners, and the sizes are those of the
/// gem.
#[test]
fn the_pictures_and_sizes_are_those_of_the_gem() {
    let design = read("small.asc", SMALL.as_bytes()).unwrap();
    let gem = Gem::new("small.asc", design, 2.5, None).unwrap();
    let page = page(&gem);
    let (_, views) = page.split_once("<div class=views>").unwrap();
    let (views, rest) = views.split_once("</div>").unwrap();
    let views: Vec<&str> = views.split("<figure>").skip(1).collect();
    // Above: four of the crown and the table. The side: one of the girdle, of the pavilion and of
    // the crown; the others are seen on edge. Below: four of the pavilion.
    let counts: Vec<usize> = views
        .iter()
        .map(|view| view.matches("<polygon").count())
        .collect();
    assert_eq!(counts, [5, 3, 4]);
    let scale = 250.0 / gem.rough.diameter_mm.max(gem.rough.height_mm);
    let range = |view: &str, axis: usize| {
        let rings = view.split("points=\"").skip(1);
        let rings = rings.map(|ring| ring.split('"').next().unwrap());
        let points = rings.flat_map(|ring| ring.split(' '));
        let values = points.map(|at| at.split(',').nth(axis).unwrap().parse::<f64>().unwrap());
        let ends = values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| {
            [low.min(value), high.max(value)]
        });
        (ends[1] - ends[0]) / scale
    };
    let height = gem.body.reach([0.0, 0.0, 1.0]) + gem.body.reach([0.0, 0.0, -1.0]);
    for (view, axis, size) in [(0, 0, 2.5), (0, 1, 2.5), (1, 0, 2.5), (1, 1, height)] {
        assert!(
            (range(views[view], axis) - size).abs() < 1e-3,
            "view {view}, axis {axis}"
        );
    }
    // Index 64 is at azimuth 0, on the right; 16 is above, and below in the view from below.
    for name in [">P</text>", ">64</text>", ">16</text>"] {
        assert!(views[2].contains(name), "{name}");
    }
    let table = gem.body.faces().iter();
    let table = table.filter(|it| gem.design.facets[it.tag].stage == Stage::Table);
    let reach = table
        .flat_map(|face| gem.body.corners(face))
        .map(|at| at[0]);
    let table = 2.0 * reach.fold(0.0, f64::max) / 2.5;
    for expected in [
        format!("<b>2.500 x 2.500 x {height:.3} mm</b>length, width, height"),
        format!(
            "L/W = 1.000 &nbsp; H/W = {:.3} &nbsp; T/W = {table:.3}",
            height / 2.5
        ),
        format!("Vol/W^3 = {:.3}", gem.body.volume() / 2.5_f64.powi(3)),
    ] {
        assert!(rest.contains(&expected), "{expected}");
    }
    // The rough, which is hidden at first, is not in the scene: the sizes under it are the stone's.
    assert!(!page.contains("\"name\":\"rough\""));
}
