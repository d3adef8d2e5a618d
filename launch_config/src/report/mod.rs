//! What was measured, for people: charts as SVG and one HTML page that holds them.
//!
//! Numbers flow in, text flows out: [`six_curves`] and [`panels`] draw charts, [`Drawing`] what is no chart (pictures, bars),
//! [`Page`] puts them on a page that needs no network. Every figure is readable in a light and in a dark setting, alone and in
//! the page: its light colours stand in its elements, and its style sheet exchanges them where dark is preferred.

mod chart;
mod curves;
mod drawing;
mod page;
mod palette;

pub use chart::{Axis, ChartError, Panel, Series, Shape, Sheet, panels};
pub use curves::{AXES, Curve, Run, Track, UNITS, six, six_curves};
pub use drawing::{Anchor, Drawing, Ink};
pub use page::{Block, Page, Section, Table, cells};
pub use palette::{colours, finished, hex};
pub use plotters::style::RGBColor as Colour;
