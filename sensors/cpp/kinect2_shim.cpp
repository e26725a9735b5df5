// libfreenect2 behind a C interface, with the colour camera's JPEG kept as it comes from the device.
#include "kinect2_shim.h"

#include <chrono>
#include <condition_variable>
#include <cstring>
#include <deque>
#include <memory>
#include <mutex>
#include <string>

#include <libfreenect2/frame_listener.hpp>
#include <libfreenect2/libfreenect2.hpp>
#include <libfreenect2/packet_pipeline.h>

namespace fn2 = libfreenect2;

namespace {

// Half a second of all three types: a reader that is slower loses the oldest, which the running numbers tell.
constexpr size_t kQueue = 45;

// Depth decoded on the CPU, colour handed through undecoded.
class NativeColorPipeline : public fn2::PacketPipeline {
 public:
  PacketParser *getRgbPacketParser() const override { return color_.getRgbPacketParser(); }
  PacketParser *getIrPacketParser() const override { return depth_.getIrPacketParser(); }
  fn2::RgbPacketProcessor *getRgbPacketProcessor() const override { return color_.getRgbPacketProcessor(); }
  fn2::DepthPacketProcessor *getDepthPacketProcessor() const override {
    return depth_.getDepthPacketProcessor();
  }

 private:
  fn2::DumpPacketPipeline color_;
  fn2::CpuPacketPipeline depth_;
};

class Queue : public fn2::FrameListener {
 public:
  bool onNewFrame(fn2::Frame::Type type, fn2::Frame *frame) override {
    std::lock_guard<std::mutex> lock(mutex_);
    if (frames_.size() == kQueue) frames_.pop_front();
    frames_.emplace_back(type, std::unique_ptr<fn2::Frame>(frame));
    ready_.notify_one();
    return true;
  }

  int read(int timeout_ms, k2_frame *out, void *data, uint32_t capacity) {
    std::unique_lock<std::mutex> lock(mutex_);
    if (!ready_.wait_for(lock, std::chrono::milliseconds(timeout_ms), [this] { return !frames_.empty(); }))
      return 0;
    const auto entry = std::move(frames_.front());
    frames_.pop_front();
    lock.unlock();
    const fn2::Frame &frame = *entry.second;
    // A raw frame's "bytes per pixel" is the length of its whole packet.
    const size_t bytes = entry.first == fn2::Frame::Color ? frame.bytes_per_pixel
                                                          : frame.width * frame.height * frame.bytes_per_pixel;
    *out = {static_cast<uint32_t>(entry.first), frame.timestamp, frame.sequence, frame.status,
            static_cast<uint32_t>(frame.width), static_cast<uint32_t>(frame.height),
            static_cast<uint32_t>(bytes)};
    if (bytes > capacity) return -1;
    std::memcpy(data, frame.data, bytes);
    return 1;
  }

 private:
  std::mutex mutex_;
  std::condition_variable ready_;
  std::deque<std::pair<fn2::Frame::Type, std::unique_ptr<fn2::Frame>>> frames_;
};

}  // namespace

struct k2_device {
  // Outlives the context, whose threads call it.
  Queue queue;
  fn2::Freenect2 context;
  fn2::Freenect2Device *device = nullptr;
};

extern "C" {

int k2_count(void) {
  fn2::Freenect2 context;
  return context.enumerateDevices();
}

int k2_serial(int index, char *serial, int size) {
  fn2::Freenect2 context;
  if (index < 0 || index >= context.enumerateDevices()) return -1;
  const std::string text = context.getDeviceSerialNumber(index);
  if (static_cast<int>(text.size()) >= size) return -1;
  std::memcpy(serial, text.c_str(), text.size() + 1);
  return 0;
}

k2_device *k2_open(const char *serial) {
  auto opened = std::make_unique<k2_device>();
  if (opened->context.enumerateDevices() == 0) return nullptr;
  opened->device = opened->context.openDevice(std::string(serial), new NativeColorPipeline());
  if (!opened->device) return nullptr;
  opened->device->setColorFrameListener(&opened->queue);
  opened->device->setIrAndDepthFrameListener(&opened->queue);
  return opened.release();
}

void k2_params(k2_device *opened, float infrared[9], float color[26]) {
  const auto ir = opened->device->getIrCameraParams();
  const auto rgb = opened->device->getColorCameraParams();
  // Both are plain structs of floats in just this order (libfreenect2.hpp).
  static_assert(sizeof(ir) == 9 * sizeof(float) && sizeof(rgb) == 26 * sizeof(float), "libfreenect2 changed");
  std::memcpy(infrared, &ir, sizeof(ir));
  std::memcpy(color, &rgb, sizeof(rgb));
}

int k2_start(k2_device *opened) { return opened->device->start() ? 0 : -1; }

int k2_read(k2_device *opened, int timeout_ms, k2_frame *frame, void *data, uint32_t capacity) {
  return opened->queue.read(timeout_ms, frame, data, capacity);
}

void k2_close(k2_device *opened) {
  // The context owns the device and deletes it.
  opened->device->stop();
  opened->device->close();
  delete opened;
}

}  // extern "C"
