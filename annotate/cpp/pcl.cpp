// PCL behind numpy: supervoxels (VCCS), Euclidean clusters.
//
// Only numpy arrays cross. Every function checks its input (nb::value_error, a ValueError in Python), releases the
// GIL while PCL works, and is deterministic. Ids are contiguous from 0; -1 marks a point without one.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/pair.h>

#include <pcl/point_types.h>
#include <pcl/search/kdtree.h>
#include <pcl/segmentation/extract_clusters.h>
#include <pcl/segmentation/supervoxel_clustering.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

namespace nb = nanobind;
using namespace nb::literals;

// PCL_NO_PRECOMPILE: what is used of PCL's templates is compiled here, and its libraries, 150 MB with all their
// instantiations, need not be carried. Only how a voxel averages its coloured points lies in them beside templates.
namespace pcl {

using ColoredVoxel = SupervoxelClustering<PointXYZRGBA>::VoxelData;
using ColoredLeaf = octree::OctreePointCloudAdjacencyContainer<PointXYZRGBA, ColoredVoxel>;

template <>
void ColoredLeaf::addPoint(const PointXYZRGBA& point) {
  ++num_points_;
  data_.xyz_ += point.getVector3fMap();
  data_.rgb_ += Eigen::Vector3f(point.r, point.g, point.b);
}

template <>
void ColoredLeaf::computeData() {
  data_.xyz_ /= static_cast<float>(num_points_);
  data_.rgb_ /= static_cast<float>(num_points_);
}

template <>
void ColoredVoxel::getPoint(PointXYZRGBA& point) const {
  const Eigen::Matrix<std::uint8_t, 3, 1> rgb = rgb_.cast<std::uint8_t>();
  point = PointXYZRGBA(xyz_[0], xyz_[1], xyz_[2], rgb[0], rgb[1], rgb[2], 0);
}

}  // namespace pcl

using Points = nb::ndarray<const float, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
using Colors = nb::ndarray<const std::uint8_t, nb::shape<-1, 3>, nb::c_contig, nb::device::cpu>;
using Ids = nb::ndarray<nb::numpy, std::int32_t, nb::ndim<1>>;
using Edges = nb::ndarray<nb::numpy, std::int32_t, nb::shape<-1, 2>>;

namespace {

// Octree keys and PCL's indices are 32 bit. The cap on the number of voxels along an axis keeps the
// octree's depth below 18, far beyond any room and far from overflow.
constexpr std::size_t kMaxPoints = 50'000'000;
constexpr float kMaxVoxelsPerAxis = 100'000.0F;

void require_positive(const char* name, float value) {
  if (!(std::isfinite(value) && value > 0.0F))
    throw nb::value_error((std::string(name) + " is " + std::to_string(value) + "; give a positive number").c_str());
}

void require_weight(const char* name, float value) {
  if (!(std::isfinite(value) && value >= 0.0F))
    throw nb::value_error((std::string(name) + " is " + std::to_string(value) + "; give zero or more").c_str());
}

void require_points(const Points& points) {
  if (points.shape(0) > kMaxPoints)
    throw nb::value_error(("the cloud has " + std::to_string(points.shape(0)) + " points; give at most " +
                           std::to_string(kMaxPoints)).c_str());
  const float* begin = points.data();
  const float* end = begin + points.size();
  const float* bad = std::find_if(begin, end, [](float x) { return !std::isfinite(x); });
  if (bad != end)
    throw nb::value_error(("point " + std::to_string((bad - begin) / 3) +
                           " is not finite; leave out points without a reading").c_str());
}

void require_same_length(const Points& points, const Colors& colors) {
  if (points.shape(0) != colors.shape(0))
    throw nb::value_error((std::to_string(points.shape(0)) + " points but " + std::to_string(colors.shape(0)) +
                           " colours; give one colour for each point").c_str());
}

// Lower corner of the cloud's box. VCCS is run from there: its octree loses points far from the origin.
Eigen::Vector3f lower_corner(const Points& points, float voxel_m) {
  const Eigen::Map<const Eigen::Matrix<float, 3, Eigen::Dynamic>> columns(points.data(), 3, points.shape(0));
  const Eigen::Vector3f low = columns.rowwise().minCoeff();
  const float span_m = (columns.rowwise().maxCoeff() - low).maxCoeff();
  if (!(span_m / voxel_m <= kMaxVoxelsPerAxis))
    throw nb::value_error(("the cloud spans " + std::to_string(span_m) + " m, too far for voxels of " +
                           std::to_string(voxel_m) + " m; drop far points or use larger voxels").c_str());
  return low;
}

template <typename PointT>
typename pcl::PointCloud<PointT>::Ptr cloud_of(const Points& points, const Eigen::Vector3f& origin) {
  auto cloud = std::make_shared<pcl::PointCloud<PointT>>();
  cloud->resize(points.shape(0));
  for (std::size_t i = 0; i < points.shape(0); ++i)
    (*cloud)[i].getVector3fMap() = Eigen::Map<const Eigen::Vector3f>(points.data() + 3 * i) - origin;
  return cloud;
}

template <typename PointT>
typename pcl::PointCloud<PointT>::Ptr cloud_of(const Points& points, const Colors& colors,
                                                 const Eigen::Vector3f& origin) {
  auto cloud = cloud_of<PointT>(points, origin);
  for (std::size_t i = 0; i < points.shape(0); ++i) {
    (*cloud)[i].r = colors(i, 0);
    (*cloud)[i].g = colors(i, 1);
    (*cloud)[i].b = colors(i, 2);
  }
  return cloud;
}

Ids to_numpy(std::vector<std::int32_t>&& values) {
  auto* held = new std::vector<std::int32_t>(std::move(values));
  nb::capsule owner(held, [](void* p) noexcept { delete static_cast<std::vector<std::int32_t>*>(p); });
  return Ids(held->data(), {held->size()}, owner);
}

Edges to_numpy(std::vector<std::array<std::int32_t, 2>>&& values) {
  auto* held = new std::vector<std::array<std::int32_t, 2>>(std::move(values));
  nb::capsule owner(held, [](void* p) noexcept { delete static_cast<std::vector<std::array<std::int32_t, 2>>*>(p); });
  return Edges(reinterpret_cast<std::int32_t*>(held->data()), {held->size(), 2}, owner);
}

// Clusters as one id for each point: the largest is 0, ties go by the first point, -1 is in none.
std::vector<std::int32_t> ids_of(std::vector<pcl::PointIndices>& clusters, std::size_t count) {
  for (auto& cluster : clusters) std::sort(cluster.indices.begin(), cluster.indices.end());
  std::sort(clusters.begin(), clusters.end(), [](const auto& a, const auto& b) {
    if (a.indices.size() != b.indices.size()) return a.indices.size() > b.indices.size();
    return a.indices < b.indices;
  });
  std::vector<std::int32_t> ids(count, -1);
  for (std::size_t id = 0; id < clusters.size(); ++id)
    for (auto index : clusters[id].indices) ids[index] = static_cast<std::int32_t>(id);
  return ids;
}

std::pair<Ids, Edges> supervoxels(const Points& points_m, const Colors& colors_rgb, float voxel_m, float seed_m,
                                  float spatial_weight, float normal_weight, float color_weight) {
  require_positive("voxel_m", voxel_m);
  require_positive("seed_m", seed_m);
  if (seed_m <= voxel_m)
    throw nb::value_error(("seed_m is " + std::to_string(seed_m) + "; give more than voxel_m, " +
                           std::to_string(voxel_m)).c_str());
  require_weight("spatial_weight", spatial_weight);
  require_weight("normal_weight", normal_weight);
  require_weight("color_weight", color_weight);
  require_same_length(points_m, colors_rgb);
  require_points(points_m);

  std::vector<std::int32_t> ids(points_m.shape(0), -1);
  std::vector<std::array<std::int32_t, 2>> edges;
  if (!ids.empty()) {
    const Eigen::Vector3f corner = lower_corner(points_m, voxel_m);
    nb::gil_scoped_release released;
    pcl::SupervoxelClustering<pcl::PointXYZRGBA> vccs(voxel_m, seed_m);
    vccs.setUseSingleCameraTransform(false);
    vccs.setInputCloud(cloud_of<pcl::PointXYZRGBA>(points_m, colors_rgb, corner));
    vccs.setSpatialImportance(spatial_weight);
    vccs.setNormalImportance(normal_weight);
    vccs.setColorImportance(color_weight);
    std::map<std::uint32_t, pcl::Supervoxel<pcl::PointXYZRGBA>::Ptr> found;
    vccs.extract(found);

    // PCL's labels start at 1, with gaps. Two seeds in one voxel leave a supervoxel that owns no point: it gets no id.
    const auto labelled = vccs.getLabeledCloud();
    std::map<std::uint32_t, std::int32_t> id_of_label;
    for (const auto& point : *labelled)
      if (point.label != 0) id_of_label.emplace(point.label, 0);
    std::int32_t next_id = 0;
    for (auto& [_, id] : id_of_label) id = next_id++;
    for (std::size_t i = 0; i < ids.size(); ++i)
      if ((*labelled)[i].label != 0) ids[i] = id_of_label.at((*labelled)[i].label);

    std::multimap<std::uint32_t, std::uint32_t> adjacency;
    vccs.getSupervoxelAdjacency(adjacency);
    for (const auto& [label, neighbour] : adjacency) {
      const auto a = id_of_label.find(label), b = id_of_label.find(neighbour);
      if (a == id_of_label.end() || b == id_of_label.end()) continue;
      edges.push_back({std::min(a->second, b->second), std::max(a->second, b->second)});
    }
    std::sort(edges.begin(), edges.end());
    edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
  }
  return {to_numpy(std::move(ids)), to_numpy(std::move(edges))};
}

Ids euclidean_clusters(const Points& points_m, float tolerance_m, int min_size) {
  require_positive("tolerance_m", tolerance_m);
  require_positive("min_size", static_cast<float>(min_size));
  require_points(points_m);

  std::vector<std::int32_t> ids;
  {
    nb::gil_scoped_release released;
    std::vector<pcl::PointIndices> clusters;
    if (points_m.shape(0) > 0) {
      pcl::EuclideanClusterExtraction<pcl::PointXYZ> extraction;
      extraction.setInputCloud(cloud_of<pcl::PointXYZ>(points_m, Eigen::Vector3f::Zero()));
      extraction.setSearchMethod(std::make_shared<pcl::search::KdTree<pcl::PointXYZ>>());
      extraction.setClusterTolerance(tolerance_m);
      extraction.setMinClusterSize(min_size);
      extraction.extract(clusters);
    }
    ids = ids_of(clusters, points_m.shape(0));
  }
  return to_numpy(std::move(ids));
}

}  // namespace

NB_MODULE(_pcl, m) {
  m.doc() = "PCL's supervoxels and clusters over numpy arrays; use annotate.cloud.supervoxels instead.";
  m.def("supervoxels", &supervoxels, "points_m"_a, "colors_rgb"_a, nb::kw_only(), "voxel_m"_a, "seed_m"_a,
        "spatial_weight"_a, "normal_weight"_a, "color_weight"_a,
        "Voxel cloud connectivity segmentation: ids (n,), -1 unassigned; edges (e, 2), each pair once, low id first.");
  m.def("euclidean_clusters", &euclidean_clusters, "points_m"_a, nb::kw_only(), "tolerance_m"_a, "min_size"_a,
        "Connected components of points within tolerance_m: ids (n,), the largest first, -1 in none.");
}
