//! The library behind the `haptimill` command.

<<<<<<< HEAD
pub mod machine;
=======
pub mod program;
>>>>>>> room/plan
