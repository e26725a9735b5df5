// What the shim uses of libfreenect2's header of this name, with one device that counts.
#pragma once
#include <atomic>
#include <chrono>
#include <cstring>
#include <memory>
#include <string>
#include <thread>

#include "frame_listener.hpp"
#include "packet_pipeline.h"

namespace libfreenect2 {

class Freenect2Device {
 public:
  struct ColorCameraParams {
    float fx, fy, cx, cy, shift_d, shift_m, mx[10], my[10];
  };
  struct IrCameraParams {
    float fx, fy, cx, cy, k1, k2, k3, p1, p2;
  };
  virtual ~Freenect2Device() {}
  virtual ColorCameraParams getColorCameraParams() = 0;
  virtual IrCameraParams getIrCameraParams() = 0;
  virtual void setColorFrameListener(FrameListener *listener) = 0;
  virtual void setIrAndDepthFrameListener(FrameListener *listener) = 0;
  virtual bool start() = 0;
  virtual bool stop() = 0;
  virtual bool close() = 0;
};

inline std::atomic<bool> device_open{false};

// Frame n is n in its first column, which is the camera's right: libfreenect2 mirrors its images. Elsewhere it is 0.
// Its JPEG is FF D8 FF and the byte n.
class FakeDevice : public Freenect2Device {
 public:
  explicit FakeDevice(const PacketPipeline *pipeline) : pipeline_(pipeline) {}
  ~FakeDevice() override { stop(); }
  ColorCameraParams getColorCameraParams() override {
    ColorCameraParams params;
    float *value = &params.fx;
    for (int i = 0; i < 26; ++i) value[i] = 1000.0f + i;
    return params;
  }
  IrCameraParams getIrCameraParams() override { return {365, 366, 254, 211, .1f, .2f, .3f, .4f, .5f}; }
  void setColorFrameListener(FrameListener *listener) override { color_ = listener; }
  void setIrAndDepthFrameListener(FrameListener *listener) override { depth_ = listener; }
  bool start() override {
    if (!pipeline_->getRgbPacketProcessor()->native || !pipeline_->getDepthPacketProcessor()->cpu) return false;
    running_ = true;
    thread_ = std::thread([this] { run(); });
    return true;
  }
  bool stop() override {
    running_ = false;
    if (thread_.joinable()) thread_.join();
    return true;
  }
  bool close() override {
    device_open = false;
    return true;
  }

 private:
  void run() {
    for (uint32_t n = 1; running_; ++n) {
      emit(color_, Frame::Color, new Frame(1, 1, 1000), n);
      emit(depth_, Frame::Ir, new Frame(512, 424, 4), n);
      emit(depth_, Frame::Depth, new Frame(512, 424, 4), n);
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
  }
  void emit(FrameListener *listener, Frame::Type type, Frame *frame, uint32_t n) {
    // The clock wraps around after a few frames; frame 5 is lost, frame 7 broken.
    frame->timestamp = 0xFFFFFF00u + 267 * n;
    frame->sequence = n;
    frame->status = n == 7;
    if (type == Frame::Color) {
      const unsigned char jpeg[4] = {0xFF, 0xD8, 0xFF, static_cast<unsigned char>(n)};
      std::memcpy(frame->data, jpeg, 4);
      frame->bytes_per_pixel = 4;
    } else {
      for (int i = 0; i < 512 * 424; ++i) reinterpret_cast<float *>(frame->data)[i] = i % 512 ? 0.0f : static_cast<float>(n);
    }
    if (n == 5 || !listener->onNewFrame(type, frame)) delete frame;
  }

  std::unique_ptr<const PacketPipeline> pipeline_;
  FrameListener *color_ = nullptr, *depth_ = nullptr;
  std::atomic<bool> running_{false};
  std::thread thread_;
};

class Freenect2 {
 public:
  int enumerateDevices() { return 1; }
  std::string getDeviceSerialNumber(int) { return "012345678947"; }
  Freenect2Device *openDevice(const std::string &serial, const PacketPipeline *pipeline) {
    if (serial != getDeviceSerialNumber(0) || device_open.exchange(true)) {
      delete pipeline;
      return nullptr;
    }
    device_.reset(new FakeDevice(pipeline));
    return device_.get();
  }

 private:
  std::unique_ptr<Freenect2Device> device_;
};

}  // namespace libfreenect2
