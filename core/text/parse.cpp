#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <array>
#include <cmath>
#include <unordered_map>

#include "text/line.hpp"
#include "text/pose_text.hpp"
#include "text/records.hpp"

namespace masat {
namespace {

// How far R'R of a matrix R in a file may be from the identity: decimals are off by far less.
constexpr double kMaxOffRotation = 1e-2;

class Parser {
 public:
  Parser(const std::vector<Record>& records, std::size_t text_size)
      : records_(records), text_size_(text_size) {}

  void read(Line& line) {
    const Record* const record = find(line);
    if (record == nullptr) return;
    switch (record->kind) {
      case Kind::kVertex:
        out_.vertex_ids.push_back(integer(line, *record));
        [[fallthrough]];
      case Kind::kPose:
      case Kind::kStampedPose: {
        if (record->kind != Kind::kVertex) {
          out_.vertex_ids.push_back(static_cast<std::int64_t>(out_.vertex_ids.size()));
        }
        out_.vertex_lines.push_back(line.number());
        std::string_view stamp;
        if (record->kind == Kind::kStampedPose) {
          stamp = Line(line).word();
          numbers(line, *record, 1);
        }
        numbers(line, *record, width_of(record->pose));
        end_of(line, *record);
        pose(line, *record, out_.vertex_poses);
        if (stamp.empty()) stamp = text_after(kStamp, line.comment());
        if (!stamp.empty()) {
          out_.vertex_stamps.resize(out_.vertex_lines.size());
          out_.vertex_stamps.back() = stamp;
        }
        return;
      }
      case Kind::kEdge:
        return edge(line, *record);
      case Kind::kPrior:
        return prior(line, *record);
      case Kind::kPoint:
        out_.point_ids.push_back(integer(line, *record));
        out_.point_lines.push_back(line.number());
        numbers(line, *record, width_of(record->pose));
        end_of(line, *record);
        pose(line, *record, out_.points);
        return;
      case Kind::kObservation:
        return observation(line, *record);
      case Kind::kParameter:
        out_.parameter_ids.push_back(integer(line, *record));
        out_.parameter_lines.push_back(line.number());
        numbers(line, *record, width_of(record->pose));
        end_of(line, *record);
        pose(line, *record, out_.parameters);
        return;
      case Kind::kFix:
        do {
          out_.fixed_ids.push_back(integer(line, *record));
          out_.fixed_lines.push_back(line.number());
        } while (!line.done());
        return;
    }
  }

  ParsedGraph take() {
    if (!out_.edge_labels.empty()) out_.edge_labels.resize(out_.edge_lines.size());
    if (!out_.vertex_stamps.empty()) out_.vertex_stamps.resize(out_.vertex_lines.size());
    return std::move(out_);
  }

 private:
  // Reads the line's tag and returns its record. A tag that the table lacks is counted: null.
  const Record* find(Line& line) {
    const bool untagged = starts_number(line.peek());
    const std::string_view tag = untagged ? std::string_view{} : line.word();
    if (last_ != nullptr && last_->tag == tag) return last_;
    for (const Record& record : records_) {
      if (record.tag == tag) return last_ = &record;
    }
    if (untagged) line.fail("expected a tag, found " + quoted(line.word()));
    const auto [entry, added] = unknown_.try_emplace(std::string(tag), out_.unknown.size());
    if (added) out_.unknown.push_back({std::string(tag), 0, line.number()});
    ++out_.unknown[entry->second].count;
    return nullptr;
  }

  [[noreturn]] static void fail(Line& line, const Record& record, const std::string& found) {
    std::string expected;
    const int dof = rows_of(record.pose);
    switch (record.kind) {
      case Kind::kVertex:
      case Kind::kPrior:
      case Kind::kPoint:
      case Kind::kParameter:
        expected = "id ";
        break;
      case Kind::kStampedPose:
        expected = "stamp ";
        break;
      case Kind::kEdge:
        expected = "from to ";
        break;
      case Kind::kObservation:
        expected = "pose point ";
        break;
      default:
        break;
    }
    if (record.parameter) expected += "parameter ";
    expected += record.kind == Kind::kFix ? "id" : words_of(record.pose);
    if (record.kind == Kind::kEdge || record.kind == Kind::kPrior ||
        record.kind == Kind::kObservation) {
      const bool full = record.information == InformationText::kCovariance;
      expected += " + " + std::to_string(full ? dof * dof : dof * (dof + 1) / 2) +
                  (full ? " covariance" : " information") + " numbers";
      if (record.information_optional) expected += " (or none)";
    }
    line.fail((record.tag.empty() ? "a line" : record.tag) + " takes: " + expected + "; " + found);
  }

  static std::int64_t integer(Line& line, const Record& record) {
    if (line.done()) fail(line, record, "the line ends before the id");
    std::int64_t value = 0;
    const std::errc error = line.try_number(value);
    if (error == std::errc::result_out_of_range) {
      line.fail("the id " + quoted(line.word()) + " does not fit in 64 bits");
    }
    if (error != std::errc{}) {
      fail(line, record, "found " + quoted(line.word()) + " where an integer id belongs");
    }
    return value;
  }

  // Reads `count` numbers into values_.
  void numbers(Line& line, const Record& record, int count) {
    for (int k = 0; k < count; ++k) {
      if (line.done()) {
        fail(line, record,
             "the line ends after " + std::to_string(k) + " of " + std::to_string(count) +
                 " numbers");
      }
      const std::errc error = line.try_number(values_[k]);
      if (error == std::errc::result_out_of_range) {
        line.fail(quoted(line.word()) + " is too large a number");
      } else if (error != std::errc{}) {
        fail(line, record, "found " + quoted(line.word()) + " where a number belongs");
      } else if (!std::isfinite(values_[k])) {
        line.fail("found a number that is not finite (nan or inf)");
      }
    }
  }

  static void end_of(Line& line, const Record& record) {
    if (!line.done()) fail(line, record, "found " + quoted(line.word()) + " after the last number");
  }

  // Appends the pose in values_.
  void pose(const Line& line, const Record& record, std::vector<double>& to) {
    const int dimension = dimension_of(record.pose);
    if (out_.dimension == 0) out_.dimension = dimension;
    if (out_.dimension != dimension) {
      line.fail(record.tag + " is " + std::to_string(dimension) + "D, the lines before are " +
                std::to_string(out_.dimension) + "D: a graph is one or the other");
    }
    const double* const v = values_.data();
    if (record.pose == PoseText::kXYZRPY) {
      using Eigen::AngleAxisd, Eigen::Vector3d;
      const Eigen::Quaterniond q(AngleAxisd(v[5], Vector3d::UnitZ()) *
                                 AngleAxisd(v[4], Vector3d::UnitY()) *
                                 AngleAxisd(v[3], Vector3d::UnitX()));
      to.insert(to.end(), {v[0], v[1], v[2], q.x(), q.y(), q.z(), q.w()});
      return;
    }
    if (record.pose == PoseText::kMatrix) {
      const auto m = Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>>(v);
      const Eigen::Matrix3d r = m.leftCols<3>();
      const double off = (r.transpose() * r - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
      if (!(off <= kMaxOffRotation) || r.determinant() < 0) {
        line.fail("the left 3x3 block of the matrix is no rotation");
      }
      const Eigen::Quaterniond q = Eigen::Quaterniond(r).normalized();
      to.insert(to.end(), {v[3], v[7], v[11], q.x(), q.y(), q.z(), q.w()});
      return;
    }
    if (record.pose == PoseText::kXYZQuat && v[3] == 0 && v[4] == 0 && v[5] == 0 && v[6] == 0) {
      line.fail("the quaternion is zero: no rotation; expected qx qy qz qw of unit length");
    }
    if (record.pose == PoseText::kBearing) to.push_back(0);  // the range, not measured
    to.insert(to.end(), v, v + width_of(record.pose));
  }

  void edge(Line& line, const Record& record) {
    if (out_.edge_lines.empty()) reserve(line.size(), record.pose);
    const std::int64_t from = integer(line, record), to = integer(line, record);
    if (from == to) {
      line.fail("the edge joins vertex " + std::to_string(from) +
                " to itself; expected two different vertices");
    }
    out_.edge_ids.insert(out_.edge_ids.end(), {from, to});
    out_.edge_lines.push_back(line.number());
    numbers(line, record, width_of(record.pose));
    pose(line, record, out_.measurements);
    if (record.pose == PoseText::kXYTheta) {
      information<3>(line, record, out_.information);
    } else {
      information<6>(line, record, out_.information);
    }
    end_of(line, record);
    if (const std::string_view label = text_after(kLabel, line.comment()); !label.empty()) {
      out_.edge_labels.resize(out_.edge_lines.size());
      out_.edge_labels.back() = label;
    }
  }

  void prior(Line& line, const Record& record) {
    out_.prior_ids.push_back(integer(line, record));
    out_.prior_lines.push_back(line.number());
    const std::int64_t parameter = record.parameter ? integer(line, record) : -1;
    // g2o reads the parameter of a position's prior, but does not apply it.
    out_.prior_parameters.push_back(is_position(record.pose) ? -1 : parameter);
    numbers(line, record, width_of(record.pose));
    pose(line, record, out_.priors);
    std::vector<double>& to = out_.prior_information;
    switch (record.pose) {
      case PoseText::kXY:
        out_.priors.push_back(0);
        padded<2>(line, record, to);
        break;
      case PoseText::kXYZ:
        out_.priors.insert(out_.priors.end(), {0, 0, 0, 1});
        padded<3>(line, record, to);
        break;
      case PoseText::kXYTheta:
        information<3>(line, record, to);
        break;
      default:
        information<6>(line, record, to);
    }
    end_of(line, record);
  }

  // Appends the information of a pose whose position alone was measured.
  template <int d>
  void padded(Line& line, const Record& record, std::vector<double>& to) {
    constexpr int dof = dof_of(d);
    std::vector<double> own;
    information<d>(line, record, own);
    const std::size_t first = to.size();
    to.resize(first + dof * dof);
    for (int r = 0; r < d; ++r) {
      for (int c = 0; c < d; ++c) to[first + r * dof + c] = own[r * d + c];
    }
  }

  void observation(Line& line, const Record& record) {
    const std::int64_t from = integer(line, record), to = integer(line, record);
    out_.observation_ids.insert(out_.observation_ids.end(), {from, to});
    out_.observation_lines.push_back(line.number());
    out_.observation_parameters.push_back(record.parameter ? integer(line, record) : -1);
    numbers(line, record, width_of(record.pose));
    pose(line, record, out_.observations);
    out_.observation_range_bearing.push_back(is_range_bearing(record.pose));
    std::vector<double>& w = out_.observation_information;
    if (record.pose == PoseText::kBearing) {
      w.insert(w.end(), 3, 0.0);
      information<1>(line, record, w);
    } else if (dimension_of(record.pose) == 2) {
      information<2>(line, record, w);
    } else {
      information<3>(line, record, w);
    }
    end_of(line, record);
  }

  // Reserves memory for as many edges of this length as the text can hold. The system provides
  // pages when they are first written, so what stays unused costs nothing.
  void reserve(std::size_t line_size, PoseText pose) {
    const std::size_t count = text_size_ / line_size + 1;
    const int dimension = dimension_of(pose), dof = dof_of(dimension);
    out_.edge_ids.reserve(2 * count);
    out_.edge_lines.reserve(count);
    out_.measurements.reserve(count * (dimension == 2 ? 3 : 7));
    out_.information.reserve(count * dof * dof);
  }

  template <int Dof>
  void information(Line& line, const Record& record, std::vector<double>& to) {
    using Matrix = Eigen::Matrix<double, Dof, Dof, Eigen::RowMajor>;
    Matrix m = Matrix::Zero();
    if (record.information_optional && line.done()) {
      ++out_.edges_without_information;
      m.setIdentity();
    } else if (record.information == InformationText::kCovariance) {
      numbers(line, record, Dof * Dof);
      const Matrix covariance = Eigen::Map<const Matrix>(values_.data());
      m = covariance.inverse();
      if (!m.allFinite()) line.fail("the covariance matrix is singular");
      m = (0.5 * (m + m.transpose())).eval();
    } else {
      numbers(line, record, Dof * (Dof + 1) / 2);
      const double* v = values_.data();
      for (int r = 0; r < Dof; ++r) {
        for (int c = r; c < Dof; ++c) m(r, c) = *v++;
      }
      if constexpr (Dof == 3) {
        if (record.information == InformationText::kToroPlanar) {
          v = values_.data();
          m(0, 0) = v[0], m(0, 1) = v[1], m(1, 1) = v[2];
          m(2, 2) = v[3], m(0, 2) = v[4], m(1, 2) = v[5];
        }
      }
      if (record.information == InformationText::kSquareRoot) m = (m.transpose() * m).eval();
      m.template triangularView<Eigen::StrictlyLower>() = m.transpose();
      if (!m.allFinite()) line.fail("the information matrix overflows");
    }
    // To first order, angles are twice the vector part of the quaternion.
    if constexpr (Dof == 6) {
      if (record.pose == PoseText::kXYZRPY) {
        m.template bottomRows<3>() *= 2;
        m.template rightCols<3>() *= 2;
      }
    }
    to.insert(to.end(), m.data(), m.data() + Dof * Dof);
  }

  const std::vector<Record>& records_;
  std::size_t text_size_;
  const Record* last_ = nullptr;
  std::unordered_map<std::string, std::size_t> unknown_;
  std::array<double, 36> values_{};
  ParsedGraph out_;
};

}  // namespace

ParsedGraph parse(std::string_view text, const std::vector<Record>& records) {
  Parser parser(records, text.size());
  for_each_line(text, [&](Line& line) { parser.read(line); });
  return parser.take();
}

}  // namespace masat
