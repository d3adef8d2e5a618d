//! OpenCV: conversion of Bayer and YUV images, debug images, and the published tracker. Nothing
//! else uses it.

mod convert;
mod draw;
mod paper;

pub(crate) use convert::convert;
pub use draw::draw;
pub(crate) use paper::PaperTracker;
