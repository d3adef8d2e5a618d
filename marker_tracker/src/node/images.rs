//! What the node does with an image: decoding, tracking, publishing, counting.

#[cfg(feature = "opencv")]
use super::debug_image;
use super::{Arrival, MarkerTrackerNode};
use crate::{
    encoding::from_encoding,
    image::{ImageError, ImageView},
    tracker::{Input, Output, Tracker, Warning},
};
use node_kit::{Level, NodeContext, convert};
use rig_model::MarkerState;
use volant_msgs::sensor_msgs::msg::{CompressedImage, Image};

impl MarkerTrackerNode {
    /// Processes a raw image.
    pub(super) fn raw(&mut self, context: &mut NodeContext<Arrival>, message: &Image) {
        self.check_frame(context, &message.header.frame_id);
        let mut scratch = std::mem::take(&mut self.converted);
        let clock = self.stages.start();
        let view = from_encoding(
            convert::stamp(&message.header.stamp),
            message.width as usize,
            message.height as usize,
            &message.encoding,
            message.is_bigendian != 0,
            message.step as usize,
            &message.data,
            &mut scratch,
        );
        self.stages.convert.end(clock);
        let result = view.and_then(|view| {
            let unseen = self.track(context, |tracker| tracker.handle(Input::Image(view)));
            self.inspect(context, unseen, (view.width, view.height), || Ok(view))
        });
        self.count_rejected(context, result);
        self.converted = scratch;
    }

    /// Processes a compressed image, decoded as far as the tracker needs it.
    pub(super) fn compressed(
        &mut self,
        context: &mut NodeContext<Arrival>,
        message: &CompressedImage,
    ) {
        self.check_frame(context, &message.header.frame_id);
        let mut decoder = std::mem::take(&mut self.decoder);
        let stamp = convert::stamp(&message.header.stamp);
        let clock = self.stages.start();
        let image = decoder.decode(stamp, &message.format, &message.data, Some(&self.tracker));
        self.stages.convert.end(clock);
        let result = image.and_then(|mut image| {
            let unseen = self.track(context, |tracker| tracker.handle_partial(&mut image));
            self.inspect(context, unseen, image.size(), || image.whole())
        });
        self.count_rejected(context, result);
        self.decoder = decoder;
    }

    /// Logs the first image in another frame than the rig file's.
    fn check_frame(&mut self, context: &NodeContext<Arrival>, frame: &str) {
        let expected = &self.rig.frames.camera;
        if frame != expected && !self.is_frame_logged {
            self.is_frame_logged = true;
            let text = format!(
                "{}: the images are in the frame `{frame}`, and frames.camera of the rig file is \
                 `{expected}`: the mounting of the rig file is used; make the two agree",
                self.source
            );
            context.log(Level::Warn, text);
        }
    }

    /// Tracks the markers in an image and publishes them; returns whether it shows none.
    fn track(
        &mut self,
        context: &mut NodeContext<Arrival>,
        handle: impl FnOnce(&mut Tracker),
    ) -> bool {
        let (clock, before) = (self.stages.start(), self.stages.detected[0]);
        handle(&mut self.tracker);
        self.stages.track.end(clock);
        self.publish(context);
        self.stages.detected[0] > before
    }

    /// Records the size (px) of the last image, its brightness where it is `unseen`, and publishes
    /// a debug image if anything subscribes to it.
    fn inspect<'a>(
        &mut self,
        context: &mut NodeContext<Arrival>,
        unseen: bool,
        size: (usize, usize),
        view: impl FnOnce() -> Result<ImageView<'a>, ImageError>,
    ) -> Result<(), ImageError> {
        self.stages.size = size;
        #[cfg(feature = "opencv")]
        let is_drawn = self.debug.subscribers() > 0;
        #[cfg(not(feature = "opencv"))]
        let (is_drawn, _) = (false, context);
        if unseen || is_drawn {
            let view = view()?;
            if unseen {
                self.stages.add_brightness(&view);
            }
            #[cfg(feature = "opencv")]
            if is_drawn {
                self.draw(context, &view);
            }
        }
        Ok(())
    }

    fn count_rejected(
        &mut self,
        context: &mut NodeContext<Arrival>,
        result: Result<(), ImageError>,
    ) {
        if let Err(error) = result {
            self.stages.reject(&error);
            let text = format!("{}: {error}", self.source);
            context.log_throttled(Level::Warn, "image", text);
        }
    }

    fn publish(&mut self, context: &mut NodeContext<Arrival>) {
        while let Some(output) = self.tracker.poll() {
            match output {
                Output::Observations(observations) => {
                    let frame = &self.rig.frames.camera;
                    self.markers.publish(convert::markers_message(frame, &observations));
                    let markers = observations.markers.0.iter();
                    let detected = markers.filter(|m| m.state == MarkerState::Detected).count();
                    self.stages.detected[detected] += 1;
                }
                Output::Warning(warning) => {
                    match warning {
                        Warning::Image(_)
                        | Warning::StampFromThePast { .. }
                        | Warning::Library { .. } => self.stages.reject(&warning),
                        Warning::Repeated { .. } => self.stages.repeated += 1,
                        Warning::CameraSize { .. } => {}
                    }
                    let text = format!("{}: {warning}", self.source);
                    context.log_throttled(Level::Warn, warning.kind(), text);
                }
            }
        }
    }

    #[cfg(feature = "opencv")]
    fn draw(&mut self, context: &mut NodeContext<Arrival>, view: &ImageView<'_>) {
        let clock = self.stages.start();
        let jpeg = debug_image::encode(view, &self.tracker.views());
        self.stages.draw.end(clock);
        match jpeg {
            Ok(data) => self.debug.publish(CompressedImage {
                header: convert::header(&self.rig.frames.camera, view.stamp),
                format: "rgb8; jpeg compressed rgb8".to_owned(),
                data,
            }),
            Err(reason) => context.log_throttled(
                Level::Warn,
                "debug image",
                format!("no debug image: {reason}"),
            ),
        }
    }
}
