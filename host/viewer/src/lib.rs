//! 3D scenes in offline HTML pages: polylines, meshes and arrows that a reader turns, zooms and
//! plays over time. The script needs WebGL 2 and loads nothing.
//!
//! # Use
//!
//! [`Scene::fragment`] is the HTML of a scene for any page; [`page`] is a whole page around such
//! fragments. A page with a fragment needs [`STYLE`] in its head and [`SCRIPT`] after its last
//! fragment; [`page`] has both. A page that makes its scenes itself, such as a live view, calls
//! the script's functions:
//!
//! | call | effect |
//! | --- | --- |
//! | `view = HaptimillViewer.create(element, scene)` | shows a scene in an element |
//! | `view.setLayer(layer)` | adds a layer, or replaces the one with its name |
//! | `view.removeLayer(name)` | removes a layer |
//! | `view.setMarker([x, y, z])` | shows a mark, such as the tool; `null` removes it |
//! | `view.setTime(t)` | shows polylines up to a time; `null` shows all |
//! | `view.fit(all)` | fits the view to all layers, or with `false` to those that are not aside; without an argument to what it showed before |
//! | `view.refit()` | the same as `view.fit()`, unless the reader has moved the view |
//! | `view.project([x, y, z])` | place on the screen (pixels), and depth |
//!
//! # Data format
//!
//! A scene is a JSON object. Arrays of numbers are JSON arrays, or text: base64 of little-endian
//! f32 (u32 for `starts`, `triangles`, `lines`), which [`Scene`] writes.
//!
//! | key of the scene | value |
//! | --- | --- |
//! | `layers` | array of layers, see below |
//! | `unit` | unit of the coordinates in labels; default `mm` |
//! | `height` | height of the view, pixels; default 560 |
//! | `smooth` | edges are smooth; default `true` |
//! | `view` | azimuth and elevation of the first view, degrees; default -40, 34 |
//!
//! | key of a layer | of | value |
//! | --- | --- | --- |
//! | `kind` | all | `lines`, `mesh` or `arrows` |
//! | `name` | all | label of the layer's switch; unique in the scene |
//! | `points` | all | x, y, z of each point; z is up |
//! | `colour` | all | `#rrggbb`, for a layer without values |
//! | `values` | all | one number for each point, which its colour shows |
//! | `scale` | all | `{label, low, high, map}` of the values; `map` is `sequential` or `diverging` |
//! | `visible` | all | whether it is shown at first; default true |
//! | `aside` | all | not of the part: a view of the part may leave it out; default false |
//! | `starts` | lines | index of the first point of each polyline; default one polyline |
//! | `times` | lines | seconds at each point, not decreasing: time line, play |
//! | `lines` | lines | program line of the motion towards each point |
//! | `width` | lines, arrows | pixels; default 1.5 |
//! | `triangles` | mesh | three indices of points for each triangle |
//! | `opacity` | mesh | 0 to 1; default 1 |
//! | `vectors` | arrows | x, y, z of each arrow, which begins at its point |
//! | `magnify` | arrows | factor of the drawn length; default 1 |

use data_encoding::BASE64;
use serde::{Serialize, Serializer};
use std::fmt::Write;

/// The script. It shows every scene of the page that is before it.
pub const SCRIPT: &str = include_str!("viewer.js");

/// Its style sheet.
pub const STYLE: &str = include_str!("viewer.css");

/// A scene; see the data format of the crate.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Scene {
    /// Layers, in the order of their switches.
    pub layers: Vec<Layer>,
    /// Unit of the coordinates; `None` is mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// Height of the view, pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height: Option<u32>,
    /// Azimuth and elevation of the first view, degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub view: Option<[f64; 2]>,
}

/// A layer: its name, colour and shape.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Layer {
    /// Label of its switch, unique in the scene.
    pub name: String,
    /// Colour, `#rrggbb`.
    pub colour: String,
    /// A number for each point, with the scale of its colour; `None` has the layer's colour.
    #[serde(flatten)]
    pub values: Option<Values>,
    /// Whether it is shown at first.
    pub visible: bool,
    /// Shape.
    #[serde(flatten)]
    pub shape: Shape,
}

/// Numbers that colours show.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Values {
    /// One for each point.
    #[serde(serialize_with = "floats")]
    pub values: Vec<f32>,
    /// Their scale.
    pub scale: Scale,
}

/// Scale of a colour map.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scale {
    /// Quantity and unit ("feed, mm/min").
    pub label: String,
    /// Value of the first colour.
    pub low: f64,
    /// Value of the last colour.
    pub high: f64,
    /// Colours.
    pub map: Map,
}

/// Colours of a scale.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Map {
    /// From dark to light, for magnitudes.
    Sequential,
    /// From blue over grey to red, for signed values.
    Diverging,
}

/// Shape of a layer. Points are x, y, z in the scene's unit; z is up.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum Shape {
    /// Polylines.
    Lines {
        /// Points of all polylines.
        #[serde(serialize_with = "places")]
        points: Vec<[f32; 3]>,
        /// Index of the first point of each polyline; empty for one polyline.
        #[serde(serialize_with = "indices")]
        starts: Vec<u32>,
        /// Seconds at each point, not decreasing; empty without a time line.
        #[serde(serialize_with = "floats")]
        times: Vec<f32>,
        /// Program line of the motion towards each point; may be empty.
        #[serde(serialize_with = "indices")]
        lines: Vec<u32>,
        /// Pixels.
        width: f32,
    },
    /// Triangles.
    Mesh {
        /// Corners.
        #[serde(serialize_with = "places")]
        points: Vec<[f32; 3]>,
        /// Indices of the corners of each triangle.
        #[serde(serialize_with = "triples")]
        triangles: Vec<[u32; 3]>,
        /// 0 to 1.
        opacity: f32,
    },
    /// Arrows.
    Arrows {
        /// Where each arrow begins.
        #[serde(serialize_with = "places")]
        points: Vec<[f32; 3]>,
        /// Each arrow.
        #[serde(serialize_with = "places")]
        vectors: Vec<[f32; 3]>,
        /// Factor of the drawn length.
        magnify: f32,
        /// Pixels.
        width: f32,
    },
}

impl Layer {
    /// Creates a visible layer in one colour, `#rrggbb`.
    #[must_use]
    pub fn new(name: impl Into<String>, colour: impl Into<String>, shape: Shape) -> Layer {
        Layer {
            name: name.into(),
            colour: colour.into(),
            values: None,
            visible: true,
            shape,
        }
    }

    /// Colours each point by its value. Callers must pass as many values as points.
    #[must_use]
    pub fn with_values(mut self, values: Vec<f32>, scale: Scale) -> Layer {
        self.values = Some(Values { values, scale });
        self
    }
}

impl Scene {
    /// Returns the scene as JSON.
    ///
    /// # Panics
    ///
    /// Never: a scene has no value that JSON lacks.
    #[must_use]
    pub fn json(&self) -> String {
        serde_json::to_string(self).expect("a scene is JSON")
    }

    /// Returns the HTML element of the scene, for a page with [`STYLE`] and, after it, [`SCRIPT`].
    #[must_use]
    pub fn fragment(&self) -> String {
        // A `</script>` within a name must not end the element.
        let json = self.json().replace('<', "\\u003c");
        format!("<div><script type=\"application/json\" data-haptimill-scene>{json}</script></div>")
    }
}

/// Returns a whole page; `style` follows [`STYLE`], and `body` is HTML with fragments of scenes.
#[must_use]
pub fn page(title: &str, style: &str, body: &str) -> String {
    let mut page = String::with_capacity(body.len() + SCRIPT.len() + 1024);
    let title = title.replace('&', "&amp;").replace('<', "&lt;");
    let _ = write!(
        page,
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width\"><title>{title}</title>\
         <style>{STYLE}{style}</style></head><body><main>{body}</main>\
         <script>{SCRIPT}</script></body></html>\n"
    );
    page
}

fn pack<S: Serializer>(bytes: Vec<u8>, out: S) -> Result<S::Ok, S::Error> {
    out.serialize_str(&BASE64.encode(&bytes))
}

fn floats<S: Serializer>(values: &[f32], out: S) -> Result<S::Ok, S::Error> {
    pack(values.iter().flat_map(|v| v.to_le_bytes()).collect(), out)
}

fn places<S: Serializer>(points: &[[f32; 3]], out: S) -> Result<S::Ok, S::Error> {
    floats(points.as_flattened(), out)
}

fn indices<S: Serializer>(values: &[u32], out: S) -> Result<S::Ok, S::Error> {
    pack(values.iter().flat_map(|v| v.to_le_bytes()).collect(), out)
}

fn triples<S: Serializer>(values: &[[u32; 3]], out: S) -> Result<S::Ok, S::Error> {
    indices(values.as_flattened(), out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(name: &str) -> Scene {
        let lines = Shape::Lines {
            points: vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.5]],
            starts: vec![],
            times: vec![0.0, 1.5],
            lines: vec![1, 2],
            width: 2.0,
        };
        let scale = Scale {
            label: "feed, mm/min".into(),
            low: 0.0,
            high: 600.0,
            map: Map::Sequential,
        };
        Scene {
            layers: vec![Layer::new(name, "#112233", lines).with_values(vec![10.0, 20.0], scale)],
            ..Scene::default()
        }
    }

    /// The keys that the script reads, with base64 of little-endian numbers.
    #[test]
    fn a_scene_has_the_documented_format() {
        let json: serde_json::Value = serde_json::from_str(&scene("cut").json()).expect("JSON");
        let layer = &json["layers"][0];
        assert_eq!(layer["kind"], "lines");
        assert_eq!(layer["name"], "cut");
        assert_eq!(layer["colour"], "#112233");
        assert_eq!(layer["scale"]["map"], "sequential");
        let text = layer["points"].as_str().expect("text");
        let bytes = BASE64.decode(text.as_bytes()).expect("base64");
        let numbers: Vec<f32> = bytes
            .chunks_exact(4)
            .map(|four| f32::from_le_bytes(four.try_into().expect("four")))
            .collect();
        assert_eq!(numbers, [1.0, 2.0, 3.0, 4.0, 5.0, 6.5]);
        assert_eq!(layer["lines"], "AQAAAAIAAAA=");
        // Every key of the table that the script does not name would be ignored.
        for key in layer.as_object().expect("object").keys() {
            assert!(
                SCRIPT.contains(&format!(".{key}")),
                "the script ignores {key}"
            );
        }
    }

    #[test]
    fn a_name_cannot_end_the_data_of_a_page() {
        let page = page("a <b>", "", &scene("</script><b>").fragment());
        assert_eq!(page.matches("</script>").count(), 2);
        assert!(page.contains("<title>a &lt;b></title>"));
        assert!(
            !page.contains("http://") && !page.contains("https://"),
            "offline"
        );
    }
}
