//! The camera_info file that ROS's camera drivers read (`camera_info_url`).

use rig_model::{CameraModel, Distortion};

/// The file's text.
pub fn camera_info_yaml(model: &CameraModel, name: &str) -> String {
    let (width, height) = model.size();
    let (f, c) = (model.focal_lengths(), model.principal_point());
    let (kind, coefficients): (&str, &[f64]) = match model.distortion() {
        Distortion::PlumbBob(d) => ("plumb_bob", d),
        Distortion::RationalPolynomial(d) => ("rational_polynomial", d),
        Distortion::Equidistant(d) => ("equidistant", d),
    };
    let list = |values: &[f64]| values.iter().map(|v| format!("{v:.9}")).collect::<Vec<_>>().join(", ");
    format!(
        "image_width: {width}\n\
         image_height: {height}\n\
         camera_name: {name}\n\
         camera_matrix:\n  rows: 3\n  cols: 3\n  data: [{}]\n\
         distortion_model: {kind}\n\
         distortion_coefficients:\n  rows: 1\n  cols: {}\n  data: [{}]\n\
         rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n\
         projection_matrix:\n  rows: 3\n  cols: 4\n  data: [{}]\n",
        list(&[f.x, 0.0, c.x, 0.0, f.y, c.y, 0.0, 0.0, 1.0]),
        coefficients.len(),
        list(coefficients),
        list(&[f.x, 0.0, c.x, 0.0, 0.0, f.y, c.y, 0.0, 0.0, 0.0, 1.0, 0.0]),
    )
}
