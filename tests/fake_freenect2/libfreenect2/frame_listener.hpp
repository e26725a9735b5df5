// What the shim uses of libfreenect2's header of this name, with the same names and types.
#pragma once
#include <cstddef>
#include <cstdint>

namespace libfreenect2 {

class Frame {
 public:
  enum Type { Color = 1, Ir = 2, Depth = 4 };
  size_t width, height, bytes_per_pixel;
  unsigned char *data;
  uint32_t timestamp = 0, sequence = 0, status = 0;

  Frame(size_t w, size_t h, size_t bytes)
      : width(w), height(h), bytes_per_pixel(bytes), data(new unsigned char[w * h * bytes]) {}
  virtual ~Frame() { delete[] data; }
};

class FrameListener {
 public:
  virtual ~FrameListener() {}
  virtual bool onNewFrame(Frame::Type type, Frame *frame) = 0;
};

}  // namespace libfreenect2
