//! Reports: charts as SVG, and HTML pages with them. [`six_curves`] and [`panels`] draw charts,
//! [`Drawing`] other figures (images, bars), and [`Page`] lays them out on a page without external
//! resources. Figures have a light and a dark color scheme: their elements have the light colors,
//! and their style sheet replaces them in a dark scheme.

mod chart;
mod curves;
mod drawing;
mod page;
mod palette;

pub use chart::{Axis, ChartError, Panel, Series, Shape, Sheet, panels};
pub use curves::{AXES, Curve, Run, Track, UNITS, six, six_curves};
pub use drawing::{Anchor, Drawing, Ink};
pub use page::{Block, Page, Section, Table, cells};
pub use palette::colors;
pub use plotters::style::RGBColor as Color;
