//! OpenCV: conversion of Bayer and YUV images, and debug images. Nothing else uses it.

mod convert;
mod draw;

pub(crate) use convert::convert;
pub use draw::draw;
