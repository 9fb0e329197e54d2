//! Tables and objects of a DXF: layers, linetypes, and the clips of block references.

use super::Reader;
use super::pairs::Pair;
use crate::drawing::Problem;

/// The layer on which CAD programs keep the points of dimensions. They never plot it, whatever its
/// flag is.
const DEFPOINTS: &str = "DEFPOINTS";

/// A layer of the tables.
#[derive(Default, Clone)]
pub(super) struct Layer {
    pub(super) hidden: bool,
    /// Whether its plot flag is 0: it is on the screen and never on paper.
    pub(super) unplotted: bool,
    pub(super) linetype: Option<String>,
}

impl Reader<'_, '_> {
    pub(super) fn layer(&mut self, record: &[Pair]) {
        let value = |code| record.iter().find(|pair| pair.code == code);
        let number = |code| value(code).and_then(|pair| pair.word().parse::<i64>().ok());
        if let Some(name) = value(2) {
            let hidden = number(62).is_some_and(|colour| colour < 0)
                || number(70).is_some_and(|flags| flags & 1 != 0);
            let linetype = value(6).map(|pair| pair.text().trim().to_uppercase());
            let layer = Layer {
                hidden,
                unplotted: number(290) == Some(0),
                linetype,
            };
            let name = name.text().trim().to_uppercase();
            self.layers.insert(name, layer);
        }
    }

    /// Why CAD programs do not plot the entities of a layer, if they do not.
    pub(super) fn unplotted(&self, layer: &str) -> Option<&'static str> {
        let name = layer.to_uppercase();
        if name == DEFPOINTS {
            return Some("layer Defpoints is not plotted");
        }
        let layer = self.layers.get(&name)?;
        layer
            .unplotted
            .then_some("its layer is not plotted (its plot flag is 0)")
    }

    pub(super) fn linetype(&mut self, record: &[Pair]) {
        let value = |code| record.iter().find(|pair| pair.code == code);
        if let Some(name) = value(2) {
            // The number of dashes and gaps.
            let parts = value(73).and_then(|pair| pair.word().parse::<i64>().ok());
            let name = name.text().trim().to_uppercase();
            self.linetypes.insert(name, parts.unwrap_or(0) > 0);
        }
    }

    /// Notes the owner of a dictionary or of a clip (XCLIP) that is switched on.
    pub(super) fn object(&mut self, kind: &str, record: &[Pair]) {
        let value = |code| record.iter().find(|pair| pair.code == code);
        let Some(handle) = value(5).map(|pair| pair.word().to_uppercase()) else {
            return;
        };
        // The last of the pointers before the first subclass is the owner.
        let head = record.iter().take_while(|pair| pair.code != 100);
        let owner = head.filter(|pair| pair.code == 330).last();
        if let Some(owner) = owner {
            let owner = owner.word().to_uppercase();
            self.owners.insert(handle.clone(), owner);
        }
        if kind == "SPATIAL_FILTER" && value(71).is_none_or(|pair| pair.word() != "0") {
            self.clips.push(handle);
        }
    }

    /// Whether a linetype has dashes. One that the tables do not have is no plain line, if it is
    /// not named as one.
    pub(super) fn is_dashed(&self, name: &str) -> bool {
        !matches!(name, "" | "CONTINUOUS" | "BYLAYER" | "BYBLOCK")
            && self.linetypes.get(name).copied().unwrap_or(true)
    }

    /// Refuses clipped block references, which would be cut whole, or notes them.
    pub(super) fn check_clips(&mut self) {
        for clip in std::mem::take(&mut self.clips) {
            // The clip is in a dictionary of the dictionary of the reference.
            let mut handle = Some(&clip);
            for _ in 0..3 {
                handle = handle.and_then(|handle| self.owners.get(handle));
            }
            let reference = match handle {
                Some(handle) => format!("INSERT handle {handle}"),
                None => format!("the reference of SPATIAL_FILTER handle {clip}"),
            };
            if self.options.ignore_clips {
                let notice = format!("cut whole, without its clip (XCLIP): {reference}");
                self.drawing.notices.push(notice);
                continue;
            }
            self.drawing.problems.push(Problem::general(
                format!("{reference}: its clip (XCLIP) hides a part of it, which would be cut"),
                "explode and trim the block in the drawing program, or cut it whole with \
                 --ignore-clips",
            ));
        }
    }
}
