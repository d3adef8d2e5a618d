//! OpenCV: conversion of Bayer and YUV images, and the published tracker. Beside them only the
//! node's debug images use it.

mod convert;
mod paper;

pub(crate) use convert::convert;
pub(crate) use paper::PaperTracker;
