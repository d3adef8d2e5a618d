//! Launch files, parameter files, robot description and layouts of Volant. No code.
//!
//! colcon installs the share folder of an `ament_cargo` package, and such a package needs a target.
