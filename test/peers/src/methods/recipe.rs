//! The paper's recipe, written plainly with OpenCV's functions on whole frames, staged as its Table
//! I.

use super::{
    About, Carrier, Estimate, Method,
    pose::{camera_matrix, point2, point3, solve_pnp},
};
use crate::clock::Clock;
use crate::scene::{Frame, Pinhole};
use anyhow::Result;
use nalgebra::Vector2;
use opencv::{
    calib3d::SolvePnPMethod,
    core::{self, Mat, Point2f, Rect, Size},
    imgproc,
    prelude::*,
    video,
};
use rig_model::MarkerLayout;

/// Bins of the hue histogram (OpenCV's hue goes to 180).
const BINS: i32 = 30;

/// What the recipe carries from one frame to the next.
pub struct Recipe {
    matrix: Mat,
    object: core::Vector<core::Point3d>,
    hsv: Mat,
    layers: [Mat; 4],
    binary: [Mat; 4],
    previous: [Mat; 4],
    histograms: [Mat; 4],
    centers: [Option<Point2f>; 4],
    half_window: [f64; 4],
}

impl Recipe {
    pub fn new(camera: &Pinhole, layout: &MarkerLayout) -> Result<Self> {
        Ok(Self {
            matrix: camera_matrix(camera)?,
            object: layout.centers.0.iter().map(point3).collect(),
            hsv: Mat::default(),
            layers: Default::default(),
            binary: Default::default(),
            previous: Default::default(),
            histograms: Default::default(),
            centers: [None; 4],
            half_window: [25.0; 4],
        })
    }

    /// Red, green, blue, yellow as differences of the layers, each made binary at 0.75 of its own
    /// largest value.
    fn identify(&mut self, rgb: &impl core::ToInputArray) -> Result<()> {
        let mut channels = core::Vector::<Mat>::new();
        core::split(rgb, &mut channels)?;
        let (r, g, b) = (channels.get(0)?, channels.get(1)?, channels.get(2)?);
        core::subtract_def(&r, &g, &mut self.layers[0])?;
        core::subtract_def(&g, &r, &mut self.layers[1])?;
        core::subtract_def(&b, &r, &mut self.layers[2])?;
        let mut rest = Mat::default();
        core::subtract_def(&r, &self.layers[0], &mut rest)?;
        core::subtract_def(&rest, &b, &mut self.layers[3])?;
        for i in 0..4 {
            let mut largest = 0.0;
            core::min_max_loc(
                &self.layers[i],
                None,
                Some(&mut largest),
                None,
                None,
                &core::no_array(),
            )?;
            imgproc::threshold(
                &self.layers[i],
                &mut self.binary[i],
                0.75 * largest,
                255.0,
                imgproc::THRESH_BINARY,
            )?;
        }
        Ok(())
    }

    /// Lucas–Kanade from the previous binary image to this one, at each marker.
    fn flow(&self) -> Result<[Option<Point2f>; 4]> {
        let mut flows = [None; 4];
        for (i, flow) in flows.iter_mut().enumerate() {
            let Some(center) = self.centers[i] else { continue };
            let from: core::Vector<Point2f> = [center].into_iter().collect();
            let mut to = core::Vector::<Point2f>::new();
            let (mut status, mut error) = (core::Vector::<u8>::new(), core::Vector::<f32>::new());
            video::calc_optical_flow_pyr_lk(
                &self.previous[i],
                &self.binary[i],
                &from,
                &mut to,
                &mut status,
                &mut error,
                Size::new(21, 21),
                3,
                core::TermCriteria::new(3, 20, 0.03)?,
                0,
                1e-4,
            )?;
            *flow = (status.get(0)? == 1).then_some(to.get(0)? - center);
        }
        Ok(flows)
    }

    /// Share of the window's pixels that bear each marker's hue; `None` where there is no window.
    fn window(&self, i: usize, flow: Option<Point2f>, width: i32, height: i32) -> Option<Rect> {
        let center = self.centers[i]?;
        let flow = flow.unwrap_or_default();
        let (x, y) = (center.x + flow.x, center.y + flow.y);
        let half = self.half_window[i] as f32 + flow.x.abs().max(flow.y.abs());
        let x0 = ((x - half) as i32).clamp(0, width - 1);
        let y0 = ((y - half) as i32).clamp(0, height - 1);
        let x1 = ((x + half) as i32 + 1).clamp(x0 + 1, width);
        let y1 = ((y + half) as i32 + 1).clamp(y0 + 1, height);
        Some(Rect::new(x0, y0, x1 - x0, y1 - y0))
    }

    /// Hue histogram under a mask, its largest bin 255.
    fn update_hue(&mut self, i: usize, window: Rect) -> Result<()> {
        let images: core::Vector<Mat> =
            [Mat::roi(&self.hsv, window)?.try_clone()?].into_iter().collect();
        let mask = Mat::roi(&self.binary[i], window)?;
        let mut histogram = Mat::default();
        imgproc::calc_hist(
            &images,
            &core::Vector::from_slice(&[0]),
            &mask,
            &mut histogram,
            &core::Vector::from_slice(&[BINS]),
            &core::Vector::from_slice(&[0.0, 180.0]),
            false,
        )?;
        core::normalize(
            &histogram,
            &mut self.histograms[i],
            0.0,
            255.0,
            core::NORM_MINMAX,
            -1,
            &core::no_array(),
        )?;
        Ok(())
    }

    /// The layer's largest blob in the whole image.
    fn largest_blob(&self, i: usize) -> Result<Option<Rect>> {
        let (mut labels, mut stats, mut centroids) =
            (Mat::default(), Mat::default(), Mat::default());
        let n = imgproc::connected_components_with_stats_def(
            &self.binary[i],
            &mut labels,
            &mut stats,
            &mut centroids,
        )?;
        let mut best = (24, None);
        for label in 1..n {
            let at = |column| stats.at_2d::<i32>(label, column).copied();
            let area = at(imgproc::CC_STAT_AREA)?;
            if area > best.0 {
                let rect = Rect::new(
                    at(imgproc::CC_STAT_LEFT)?,
                    at(imgproc::CC_STAT_TOP)?,
                    at(imgproc::CC_STAT_WIDTH)?,
                    at(imgproc::CC_STAT_HEIGHT)?,
                );
                best = (area, Some(rect));
            }
        }
        Ok(best.1)
    }
}

impl Method for Recipe {
    fn about(&self) -> About {
        About {
            name: "the paper's recipe, plain OpenCV",
            carrier: Carrier::Markers,
            stages: &["optical flow", "tracking", "feature extraction", "extrinsics"],
        }
    }

    fn estimate(&mut self, frame: &Frame) -> Result<Estimate> {
        let (width, height) = (frame.width as i32, frame.height as i32);
        let rgb = Mat::new_rows_cols_with_bytes::<core::Vec3b>(height, width, &frame.rgb)?;
        // Feature extraction, first half: the binary images, which the flow works on.
        let start = Clock::start();
        self.identify(&rgb)?;
        let mut extraction = start.elapsed();

        let start = Clock::start();
        let flows = self.flow()?;
        let flow_time = start.elapsed();

        // Tracking: the hue histogram decides where in its window a marker is.
        let start = Clock::start();
        imgproc::cvt_color_def(&rgb, &mut self.hsv, imgproc::COLOR_RGB2HSV)?;
        let mut masks: [Option<(Mat, Rect)>; 4] = Default::default();
        for (i, mask) in masks.iter_mut().enumerate() {
            let Some(window) = self.window(i, flows[i], width, height) else { continue };
            let images: core::Vector<Mat> =
                [Mat::roi(&self.hsv, window)?.try_clone()?].into_iter().collect();
            let (mut likely, mut hue) = (Mat::default(), Mat::default());
            imgproc::calc_back_project(
                &images,
                &core::Vector::from_slice(&[0]),
                &self.histograms[i],
                &mut likely,
                &core::Vector::from_slice(&[0.0, 180.0]),
                1.0,
            )?;
            imgproc::threshold(&likely, &mut hue, 40.0, 255.0, imgproc::THRESH_BINARY)?;
            let mut both = Mat::default();
            core::bitwise_and_def(&Mat::roi(&self.binary[i], window)?, &hue, &mut both)?;
            *mask = Some((both, window));
        }
        let tracking = start.elapsed();

        // Feature extraction, second half: centers of mass.
        let start = Clock::start();
        for (i, mask) in masks.into_iter().enumerate() {
            let mut found = None;
            if let Some((mask, window)) = mask {
                found = centre_of_mass(&mask, window)?;
            }
            if found.is_none()
                && let Some(window) = self.largest_blob(i)?
            {
                self.update_hue(i, window)?;
                found = centre_of_mass(&Mat::roi(&self.binary[i], window)?.try_clone()?, window)?;
            }
            self.centers[i] = found.map(|f| f.0);
            self.half_window[i] = found.map_or(25.0, |f| (0.9 * f.1.sqrt()).max(25.0));
        }
        std::mem::swap(&mut self.previous, &mut self.binary);
        extraction += start.elapsed();

        let start = Clock::start();
        let points: Vec<(usize, Vector2<f64>)> = self
            .centers
            .iter()
            .enumerate()
            .filter_map(|(i, c)| c.map(|c| (i, Vector2::new(f64::from(c.x), f64::from(c.y)))))
            .collect();
        let mut pose = None;
        if points.len() == 4 {
            let image: core::Vector<core::Point2d> =
                points.iter().map(|(_, p)| point2(p)).collect();
            pose = solve_pnp(
                &self.matrix,
                &self.object,
                &image,
                SolvePnPMethod::SOLVEPNP_ITERATIVE,
                false,
            )?;
        }
        Ok(Estimate {
            camera_from_volant: pose,
            points,
            stages: vec![flow_time, tracking, extraction, start.elapsed()],
        })
    }

    fn forget(&mut self) {
        self.centers = [None; 4];
    }
}

fn centre_of_mass(mask: &Mat, window: Rect) -> Result<Option<(Point2f, f64)>> {
    let moments = imgproc::moments(mask, true)?;
    Ok((moments.m00 >= 25.0).then(|| {
        let center = Point2f::new(
            (moments.m10 / moments.m00) as f32 + window.x as f32,
            (moments.m01 / moments.m00) as f32 + window.y as f32,
        );
        (center, moments.m00)
    }))
}
