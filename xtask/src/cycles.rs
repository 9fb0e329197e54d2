//! Dependency cycles: files of a crate that import each other in a loop.
//!
//! Cargo forbids cycles between crates. Within a crate a pair of files may import each other, a
//! larger cycle may not: none of its files can be read alone. An import is a path to an item of
//! another file. A re-export hands a name on and is no import, and neither is a path of a module
//! into its own folder, which is a part of it. Tests and the contents of macro calls do not count.
//!
//! A module with its folder is also checked as a whole: modules beside each other, each with all
//! files of its folder, may form pairs and no larger cycle. A file deep in one folder that imports
//! from a module above it is found in this way.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use syn::visit::Visit;

/// Most files of a cycle.
const MAX_FILES: usize = 2;

/// Longest chain of re-exports that is followed.
const MAX_REEXPORTS: usize = 16;

/// Path of a module or item from the root of its crate.
type Names = Vec<String>;

/// What a module has.
#[derive(Default)]
struct Module {
    /// Index of its file.
    file: usize,
    /// Names of the items that it defines.
    items: BTreeSet<String>,
    /// Names that it imports, with their paths.
    uses: BTreeMap<String, Names>,
    /// Paths of which it imports all names.
    globs: Vec<Names>,
    /// Paths to other items that its code has.
    references: Vec<Names>,
}

/// The modules of a crate.
#[derive(Default)]
struct Crate {
    files: Vec<PathBuf>,
    /// Module of each file.
    roots: Vec<Names>,
    modules: BTreeMap<Names, Module>,
}

/// Checks every crate below `root`.
///
/// # Errors
///
/// Returns the number of cycles of more than two files, or the file that cannot be read.
pub fn lint(root: &Path) -> Result<(), String> {
    let mut manifests = Vec::new();
    super::lint::list(root, &["Cargo.toml"], &mut manifests)?;
    manifests.sort();
    let mut count = 0;
    for manifest in manifests {
        let folder = manifest.parent().unwrap_or(root).join("src");
        for start in ["lib.rs", "main.rs"] {
            let start = folder.join(start);
            if !start.is_file() {
                continue;
            }
            for cycle in cycles(&start)? {
                let files: Vec<String> = cycle
                    .iter()
                    .map(|file| {
                        file.strip_prefix(root)
                            .unwrap_or(file)
                            .display()
                            .to_string()
                    })
                    .collect();
                println!(
                    "dependency cycle of {} files: {}",
                    files.len(),
                    files.join(", ")
                );
                count += 1;
            }
        }
    }
    match count {
        0 => Ok(()),
        count => Err(format!(
            "{count} dependency cycles have more than {MAX_FILES} files; move the shared definition \
             to a file of its own"
        )),
    }
}

/// Returns the cycles of more than two files of the crate with this first file.
fn cycles(start: &Path) -> Result<Vec<Vec<PathBuf>>, String> {
    let mut found = all_cycles(start)?;
    found.retain(|files| files.len() > MAX_FILES);
    Ok(found.into_iter().collect())
}

/// Returns the number of files of the largest cycle of a crate; 1 where there is none.
///
/// # Errors
///
/// Returns the file that cannot be read.
pub fn largest(start: &Path) -> Result<usize, String> {
    let cycles = all_cycles(start)?;
    Ok(cycles.iter().map(Vec::len).max().unwrap_or(1))
}

/// Returns the files that import each other, and the modules that do so with their folders. A file
/// or module in no cycle is one by itself.
fn all_cycles(start: &Path) -> Result<BTreeSet<Vec<PathBuf>>, String> {
    let mut krate = Crate::default();
    krate.read(start, start.parent().unwrap_or(start), Vec::new())?;
    let edges = [krate.edges(), krate.contracted_edges()];
    let cycles = edges.iter().flat_map(|edges| components(edges));
    Ok(cycles
        .map(|files| {
            let paths = files.into_iter().map(|file| krate.files[file].clone());
            paths.collect()
        })
        .collect())
}

impl Crate {
    /// Reads a file and the files of its modules. `folder` has the files of its child modules.
    fn read(&mut self, path: &Path, folder: &Path, names: Names) -> Result<(), String> {
        let text =
            fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))?;
        let file =
            syn::parse_file(&text).map_err(|error| format!("{}: {error}", path.display()))?;
        self.files.push(path.to_path_buf());
        self.roots.push(names.clone());
        let index = self.files.len() - 1;
        self.add(index, &file.items, folder, names)
    }

    /// Adds the module `names` with its items.
    fn add(
        &mut self,
        file: usize,
        items: &[syn::Item],
        folder: &Path,
        names: Names,
    ) -> Result<(), String> {
        let mut module = Module {
            file,
            ..Module::default()
        };
        for item in items {
            if is_test(item) {
                continue;
            }
            match item {
                syn::Item::Mod(child) => {
                    let name = child.ident.to_string();
                    let folder = folder.join(&name);
                    let names = [&names[..], &[name]].concat();
                    if let Some((_, items)) = &child.content {
                        self.add(file, items, &folder, names)?;
                        continue;
                    }
                    let beside = folder.with_extension("rs");
                    let inside = folder.join("mod.rs");
                    if let Some(path) = [beside, inside].iter().find(|path| path.is_file()) {
                        self.read(path, &folder, names)?;
                    }
                }
                syn::Item::Use(import) => {
                    module.import(&names, Vec::new(), &import.tree, is_private(&import.vis));
                }
                item => {
                    module.items.extend(name_of(item));
                    let mut visitor = References {
                        names: &names,
                        found: &mut module.references,
                    };
                    visitor.visit_item(item);
                }
            }
        }
        self.modules.insert(names, module);
        Ok(())
    }

    /// Returns the pairs of files of which the first imports the second.
    fn edges(&self) -> Vec<BTreeSet<usize>> {
        let mut edges = vec![BTreeSet::new(); self.files.len()];
        for (names, module) in &self.modules {
            for path in &module.references {
                if let Some(file) = self.file_of(path, MAX_REEXPORTS)
                    && file != module.file
                    && !self.roots[file].starts_with(names)
                {
                    edges[module.file].insert(file);
                }
            }
        }
        edges
    }

    /// Returns the pairs of sibling modules of which the first, or a file in its folder, imports
    /// the second or a file in its folder.
    fn contracted_edges(&self) -> Vec<BTreeSet<usize>> {
        let mut edges = vec![BTreeSet::new(); self.files.len()];
        for (importer, imports) in self.edges().iter().enumerate() {
            for &imported in imports {
                let (from, to) = (&self.roots[importer], &self.roots[imported]);
                let common = from.iter().zip(to).take_while(|(a, b)| a == b).count();
                // A file and the module above it are no siblings.
                if from.len() == common || to.len() == common {
                    continue;
                }
                let sibling = |names: &Names| {
                    let above = &names[..=common];
                    self.roots.iter().position(|root| root == above)
                };
                if let (Some(from), Some(to)) = (sibling(from), sibling(to)) {
                    edges[from].insert(to);
                }
            }
        }
        edges
    }

    /// Returns the file that defines the item at a path, through re-exports.
    fn file_of(&self, path: &[String], reexports: usize) -> Option<usize> {
        let depth = (0..=path.len())
            .rev()
            .find(|depth| self.modules.contains_key(&path[..*depth]))?;
        let module = &self.modules[&path[..depth]];
        let Some(name) = path.get(depth) else {
            return Some(module.file);
        };
        if module.items.contains(name) {
            return Some(module.file);
        }
        if reexports == 0 {
            return None;
        }
        let rest = &path[depth + 1..];
        if let Some(target) = module.uses.get(name) {
            return self.file_of(&[&target[..], rest].concat(), reexports - 1);
        }
        module.globs.iter().find_map(|glob| {
            let target = [&glob[..], &path[depth..]].concat();
            // A path that ends at the module itself did not find the name.
            let file = self.file_of(&target, reexports - 1)?;
            (file != module.file).then_some(file)
        })
    }
}

impl Module {
    /// Takes the names of an import.
    fn import(&mut self, names: &Names, mut path: Names, tree: &syn::UseTree, is_private: bool) {
        match tree {
            syn::UseTree::Path(step) => {
                path.push(step.ident.to_string());
                self.import(names, path, &step.tree, is_private);
            }
            syn::UseTree::Group(group) => {
                for tree in &group.items {
                    self.import(names, path.clone(), tree, is_private);
                }
            }
            syn::UseTree::Name(name) if name.ident == "self" => {
                let last = path.last().cloned().unwrap_or_default();
                self.bind(names, last, path, is_private);
            }
            syn::UseTree::Name(name) => {
                path.push(name.ident.to_string());
                self.bind(names, name.ident.to_string(), path, is_private);
            }
            syn::UseTree::Rename(rename) => {
                path.push(rename.ident.to_string());
                self.bind(names, rename.rename.to_string(), path, is_private);
            }
            syn::UseTree::Glob(_) => {
                let path = absolute(names, &path);
                if is_private {
                    self.references.push(path.clone());
                }
                self.globs.push(path);
            }
        }
    }

    fn bind(&mut self, names: &Names, name: String, path: Names, is_private: bool) {
        let path = absolute(names, &path);
        if is_private {
            self.references.push(path.clone());
        }
        self.uses.insert(name, path);
    }
}

/// Collects the paths of code that begin at the crate, at a parent or at a module.
struct References<'a> {
    names: &'a Names,
    found: &'a mut Vec<Names>,
}

impl Visit<'_> for References<'_> {
    fn visit_path(&mut self, path: &syn::Path) {
        let steps: Names = path
            .segments
            .iter()
            .map(|segment| segment.ident.to_string())
            .collect();
        if steps.len() > 1 {
            self.found.push(absolute(self.names, &steps));
        }
        syn::visit::visit_path(self, path);
    }
}

/// Returns a path from the root of the crate. A path that begins with another name is taken as
/// one of a child module, and leads nowhere where there is none.
fn absolute(names: &Names, path: &[String]) -> Names {
    let mut base = names.clone();
    for (place, step) in path.iter().enumerate() {
        match step.as_str() {
            "crate" => base.clear(),
            "self" => {}
            "super" => {
                base.pop();
            }
            _ => {
                base.extend_from_slice(&path[place..]);
                break;
            }
        }
    }
    base
}

fn is_private(visibility: &syn::Visibility) -> bool {
    matches!(visibility, syn::Visibility::Inherited)
}

/// Returns the attributes and the name of an item.
fn parts(item: &syn::Item) -> (&[syn::Attribute], Option<&syn::Ident>) {
    match item {
        syn::Item::Const(item) => (&item.attrs, Some(&item.ident)),
        syn::Item::Enum(item) => (&item.attrs, Some(&item.ident)),
        syn::Item::Fn(item) => (&item.attrs, Some(&item.sig.ident)),
        syn::Item::Macro(item) => (&item.attrs, item.ident.as_ref()),
        syn::Item::Mod(item) => (&item.attrs, Some(&item.ident)),
        syn::Item::Static(item) => (&item.attrs, Some(&item.ident)),
        syn::Item::Struct(item) => (&item.attrs, Some(&item.ident)),
        syn::Item::Trait(item) => (&item.attrs, Some(&item.ident)),
        syn::Item::Type(item) => (&item.attrs, Some(&item.ident)),
        syn::Item::Impl(item) => (&item.attrs, None),
        syn::Item::Use(item) => (&item.attrs, None),
        _ => (&[], None),
    }
}

fn name_of(item: &syn::Item) -> Option<String> {
    parts(item).1.map(ToString::to_string)
}

/// Whether an item is built for tests only.
fn is_test(item: &syn::Item) -> bool {
    parts(item).0.iter().any(|attribute| {
        attribute.path().is_ident("cfg")
            && attribute
                .parse_args::<syn::Ident>()
                .is_ok_and(|condition| condition == "test")
    })
}

/// Returns the sets of files that reach each other, each in ascending order.
fn components(edges: &[BTreeSet<usize>]) -> Vec<Vec<usize>> {
    let reached: Vec<BTreeSet<usize>> = (0..edges.len())
        .map(|start| {
            let mut seen = BTreeSet::new();
            let mut open: Vec<usize> = edges[start].iter().copied().collect();
            while let Some(file) = open.pop() {
                if seen.insert(file) {
                    open.extend(&edges[file]);
                }
            }
            seen
        })
        .collect();
    let mut taken: BTreeSet<usize> = BTreeSet::new();
    let mut components = Vec::new();
    for start in 0..edges.len() {
        if taken.contains(&start) {
            continue;
        }
        let mut component = vec![start];
        component
            .extend((start + 1..edges.len()).filter(|other| {
                reached[start].contains(other) && reached[*other].contains(&start)
            }));
        taken.extend(&component);
        components.push(component);
    }
    components
}

#[cfg(test)]
mod tests {
    use super::cycles;
    use std::fs;
    use std::path::Path;

    /// Writes a crate of these files and returns the names of the files of each cycle.
    fn found(files: &[(&str, &str)]) -> Vec<Vec<String>> {
        let folder = std::env::temp_dir().join(format!(
            "haptimill-cycles-{}-{}",
            std::process::id(),
            files.len()
        ));
        for (name, text) in files {
            let path = folder.join(name);
            fs::create_dir_all(path.parent().unwrap_or(Path::new("."))).expect("a folder");
            fs::write(path, text).expect("a file");
        }
        let cycles = cycles(&folder.join("lib.rs")).expect("sources");
        fs::remove_dir_all(&folder).expect("the folder");
        let name = |path: &std::path::PathBuf| {
            path.strip_prefix(&folder)
                .unwrap_or(path)
                .display()
                .to_string()
        };
        cycles
            .iter()
            .map(|cycle| cycle.iter().map(name).collect())
            .collect()
    }

    #[test]
    fn a_cycle_of_three_is_found_through_a_reexport() {
        let files = [
            ("lib.rs", "mod a; mod b; mod c;"),
            ("a.rs", "use crate::b::B; pub struct A(B);"),
            ("b.rs", "pub struct B(super::c::C);"),
            (
                "c.rs",
                "use crate::d::A; mod deep { pub use crate::a::A; } pub struct C(deep::A);",
            ),
        ];
        assert_eq!(found(&files), [["a.rs", "b.rs", "c.rs"]]);
    }

    /// The files `d/deep.rs`, `a.rs` and `b.rs` alone are in no cycle: `b.rs` imports `d/mod.rs`.
    #[test]
    fn a_cycle_through_a_folder_is_found() {
        let files = [
            ("lib.rs", "mod a; mod b; mod d;"),
            ("e.rs", ""),
            ("a.rs", "pub struct A(crate::b::B);"),
            ("b.rs", "pub struct B(crate::d::D);"),
            ("d/mod.rs", "mod deep; pub use deep::react; pub struct D;"),
            ("d/deep.rs", "pub fn react(_: &crate::a::A) {}"),
        ];
        assert_eq!(found(&files), [["a.rs", "b.rs", "d/mod.rs"]]);
    }

    #[test]
    fn pairs_tests_and_reexports_are_allowed() {
        let files = [
            ("lib.rs", "mod a; mod b; mod c; pub use a::A; pub use c::C;"),
            ("a.rs", "use crate::b::B; pub struct A(B);"),
            ("b.rs", "pub struct B(crate::A);"),
            ("c.rs", "pub struct C(crate::A);"),
            ("d.rs", "#[cfg(test)] mod tests { use crate::C; }"),
        ];
        assert!(found(&files).is_empty());
    }
}
