// The real libfreenect2's registration behind a C function, for the parity test where the library is installed.
#include <cstring>

#include <libfreenect2/libfreenect2.hpp>
#include <libfreenect2/registration.h>

namespace fn2 = libfreenect2;

extern "C" void register_frame(const float *infrared, const float *color, const float *depth,
                               const unsigned char *bgrx, float *undistorted, unsigned char *registered) {
  fn2::Freenect2Device::IrCameraParams ir;
  fn2::Freenect2Device::ColorCameraParams rgb;
  std::memcpy(&ir, infrared, sizeof(ir));
  std::memcpy(&rgb, color, sizeof(rgb));
  fn2::Frame depth_frame(512, 424, 4), color_frame(1920, 1080, 4), out(512, 424, 4), out_color(512, 424, 4);
  std::memcpy(depth_frame.data, depth, 512 * 424 * 4);
  std::memcpy(color_frame.data, bgrx, 1920 * 1080 * 4);
  fn2::Registration(ir, rgb).apply(&color_frame, &depth_frame, &out, &out_color);
  std::memcpy(undistorted, out.data, 512 * 424 * 4);
  std::memcpy(registered, out_color.data, 512 * 424 * 4);
}
