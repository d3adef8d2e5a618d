//! What a recorded bag has for the tracker.

#![allow(clippy::unwrap_used, clippy::panic)] // clippy does not recognize helpers of tests

use rig_model::{CameraModel, Rig, Stamp, topics};
use std::path::Path;

/// A message of the camera.
pub enum Recorded {
    Camera(CameraModel),
    Image { stamp: Stamp, format: String, data: Vec<u8> },
}

/// The rig file of a bag's folder, and the camera's messages in the order of the bag.
pub fn read(folder: &Path) -> (Rig, Vec<Recorded>) {
    let rig = Rig::from_yaml(&std::fs::read_to_string(folder.join("rig.yaml")).unwrap()).unwrap();
    let file = std::fs::read(folder.join("in.mcap")).unwrap();
    let messages = mcap::MessageStream::new(&file).unwrap().filter_map(|message| {
        let message = message.unwrap();
        let mut c = Cdr::new(&message.data);
        match message.channel.topic.as_str() {
            topics::absolute::CAMERA_INFO => {
                c.stamp();
                let (h, w) = (c.u32(), c.u32());
                let model = c.text().to_owned();
                let d: Vec<f64> = (0..c.u32()).map(|_| c.f64()).collect();
                let k: [f64; 9] = std::array::from_fn(|_| c.f64());
                let camera = CameraModel::from_camera_info(w, h, &model, &d, &k).unwrap();
                Some(Recorded::Camera(camera))
            }
            topics::absolute::COMPRESSED_IMAGE => {
                let stamp = c.stamp();
                let format = c.text().to_owned();
                let n = c.u32() as usize;
                Some(Recorded::Image { stamp, format, data: c.bytes(n, 1).to_vec() })
            }
            _ => None,
        }
    });
    (rig, messages.collect())
}

/// Cursor over little-endian CDR, as far as these two messages need it.
struct Cdr<'a>(&'a [u8], usize);

impl<'a> Cdr<'a> {
    fn new(data: &'a [u8]) -> Self {
        Self(&data[4..], 0)
    }
    fn bytes(&mut self, n: usize, align: usize) -> &'a [u8] {
        self.1 = self.1.next_multiple_of(align);
        let out = &self.0[self.1..self.1 + n];
        self.1 += n;
        out
    }
    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.bytes(4, 4).try_into().unwrap())
    }
    fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.bytes(8, 8).try_into().unwrap())
    }
    fn text(&mut self) -> &'a str {
        let n = self.u32() as usize;
        std::str::from_utf8(&self.bytes(n, 1)[..n - 1]).unwrap()
    }
    fn stamp(&mut self) -> Stamp {
        let (s, n) = (self.u32(), self.u32());
        let _frame = self.text();
        Stamp::from_sec_nanosec(s as i32, n)
    }
}
