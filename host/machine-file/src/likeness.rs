//! The known key that an unknown one is most like.

/// Returns the candidate that is most like a key, if it is like enough to be suggested.
pub fn nearest<'k>(key: &str, candidates: &[&'k str]) -> Option<&'k str> {
    let nearest = candidates
        .iter()
        .min_by_key(|candidate| dissimilarity(key, candidate))?;
    (dissimilarity(key, nearest) <= (key.len() / 3).max(2)).then_some(nearest)
}

/// Returns the edit distance of two keys; 1 if they differ only in their unit (`rate_mm_s`,
/// `rate_deg_s`).
fn dissimilarity(left: &str, right: &str) -> usize {
    let stem = |key: &str| {
        let units = ["_mm", "_deg", "_n", "_kg", "_ms", "_us", "_hz"];
        let cut = units.iter().filter_map(|unit| {
            let at = key.find(unit)?;
            let after = key.as_bytes().get(at + unit.len());
            after.is_none_or(|b| *b == b'_').then_some(at)
        });
        key[..cut.min().unwrap_or(key.len())].to_string()
    };
    if left != right && stem(left) == stem(right) {
        return 1;
    }
    let right: Vec<char> = right.chars().collect();
    let mut row: Vec<usize> = (0..=right.len()).collect();
    for (i, l) in left.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, r) in right.iter().enumerate() {
            let change = diagonal + usize::from(l != *r);
            diagonal = row[j + 1];
            row[j + 1] = change.min(row[j] + 1).min(row[j + 1] + 1);
        }
    }
    row[right.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_key_is_suggested_if_it_is_like_enough() {
        let keys = ["rate_mm_s", "low_mm", "counts_per_turn"];
        for (key, expected) in [
            ("rate_mms", Some("rate_mm_s")),
            ("rate_deg_s", Some("rate_mm_s")),
            ("count_per_turns", Some("counts_per_turn")),
            ("lo_mm", Some("low_mm")),
            ("colour", None),
            ("x", None),
        ] {
            assert_eq!(nearest(key, &keys), expected, "{key}");
        }
        assert_eq!(nearest("low_mm", &[]), None);
    }
}
