!> A family of free motions of a driven system without losses and loads, followed along
!! its amplitude or energy, with Floquet multipliers.
module viscovib_free_family
  use viscovib_curve_branch, only: curve_branch_type, curve_completed, curve_options, follow_curve
  use viscovib_driven_system, only: differentiable_system_type
  use viscovib_free_curve, only: free_curve_type, new_free_curve
  use viscovib_kinds, only: wp
  use viscovib_orbit_floquet, only: orbit_floquet_type
  use viscovib_orbit_multipliers, only: multipliers_of
  use viscovib_status, only: status_type
  use viscovib_torus, only: new_torus, torus_type
  implicit none
  private

  public :: free_family_type, free_options, follow_family

  !> A multiplier larger than this grows: of free motions they come in pairs about the
  !! circle, known to the root of rounding where two of them meet.
  real(wp), parameter, public :: free_circle = 1.0_wp + 1.0e-6_wp

  type :: free_options
    !> Which orders of which coordinates, from 0, are unknowns, shape (n_orders, n_dof).
    logical, allocatable :: kept(:, :)
    !> Base frequency of small motions.
    real(wp) :: unit = 1.0_wp
    !> The amplitude is that of an order of a coordinate; dof = 0: by energy.
    integer :: dof = 0, order = 1
    type(curve_options) :: curve
    logical :: stability = .true.
  end type free_options

  !> Of n points. Cosines are those of all orders, shape (n_orders n_dof).
  type :: free_family_type
    integer :: outcome = curve_completed
    !> Shape (n), cosines (n_orders n_dof, n).
    real(wp), allocatable :: parameter(:), nu(:), energy(:), x(:, :)
    !> Largest first, NaN where unknown, shape (2 n_dof, n); none if not wanted.
    complex(wp), allocatable :: multipliers(:, :)
    real(wp), allocatable :: folds(:)
    !> Where others cross: parameter, frequency, cosines, direction in cosines, frequency
    !! and parameter, and the last point before.
    real(wp), allocatable :: branch_p(:), branch_nu(:), branch_x(:, :), across(:, :)
    integer, allocatable :: branch_before(:)
  end type free_family_type

contains

  !> From motions near the cosines `begin`, which are only scaled to size; or, with
  !! `along`, from the cosines `begin` of frequency begin_nu and size begin_p in that
  !! direction (cosines, frequency, size).
  subroutine follow_family(family, system, options, begin, status, cancel, begin_nu, begin_p, along)
    type(free_family_type), intent(out) :: family
    !> Without damping; its loads are left out.
    class(differentiable_system_type), intent(in), target :: system
    type(free_options), intent(in) :: options
    real(wp), intent(in) :: begin(:)
    type(status_type), intent(out) :: status
    !> May be set from elsewhere to give up.
    integer, intent(inout), volatile, optional :: cancel
    real(wp), intent(in), optional :: begin_nu, begin_p, along(:)
    type(torus_type) :: torus
    type(free_curve_type) :: curve
    type(curve_branch_type) :: branch
    type(orbit_floquet_type) :: floquet
    real(wp), allocatable :: at(:), r(:), slope(:), jacobian(:, :), direction(:)
    real(wp) :: matrix(2*system%n_dof, 2*system%n_dof)
    logical :: inside
    integer :: i, m, n

    m = size(options%kept, 1)
    call new_torus(torus, reshape([(i, i=0, m - 1)], [1, m]), status)
    if (status%failed()) return
    call new_free_curve(curve, system, torus, options%kept, options%unit, options%dof, &
                        options%order)
    if (present(along)) then
      n = size(begin)
      at = unknowns_of(begin, begin_nu/options%unit)
      direction = [unknowns_of(along(:n), along(n + 1)), along(n + 2)]
      call follow_curve(curve, options%curve, at, branch, begin_p, direction, cancel)
    else
      at = unknowns_of(begin, 1.0_wp)
      associate (cosines => at(:curve%motion%n))
        if (options%dof > 0) then
          cosines = cosines*(options%curve%start/cosines(curve%measured))
        else
          cosines = cosines*sqrt(options%curve%start/curve%energy(at))
        end if
      end associate
      call follow_curve(curve, options%curve, at, branch, cancel=cancel)
    end if
    n = branch%n_points
    family%outcome = branch%outcome
    family%parameter = branch%parameter(:n)
    family%folds = branch%folds%p(:branch%folds%n)
    allocate (family%nu(n), family%energy(n), family%x(size(begin), n), source=0.0_wp)
    if (options%stability) allocate (family%multipliers(2*system%n_dof, n), &
                                     source=(0.0_wp, 0.0_wp))
    allocate (r(curve%n), slope(curve%n), jacobian(curve%n, curve%n))
    do i = 1, n
      if (present(cancel)) then
        if (cancel /= 0) exit
      end if
      associate (point => branch%x(:, i))
        family%x(:, i) = cosines_of(point)
        family%nu(i) = curve%frequency(point)
        family%energy(i) = curve%energy(point)
        if (.not. options%stability) cycle
        call curve%equations(point, branch%parameter(i), r, jacobian, slope, inside)
        call floquet%monodromy(curve%motion, point(:curve%motion%n), matrix)
        call multipliers_of(matrix, family%multipliers(:, i))
      end associate
    end do
    associate (points => branch%branch_points)
      family%branch_p = points%p(:points%n)
      family%branch_before = points%before(:points%n)
      allocate (family%branch_nu(points%n), family%branch_x(size(begin), points%n), &
                family%across(size(begin) + 2, points%n))
      do i = 1, points%n
        family%branch_nu(i) = curve%frequency(points%x(:, i))
        family%branch_x(:, i) = cosines_of(points%x(:, i))
        family%across(:, i) = [cosines_of(points%across(:, i)), points%across(curve%n:, i)]
      end do
    end associate

  contains

    !> Of the curve, from cosines and the last one.
    function unknowns_of(cosines, last) result(unknowns)
      real(wp), intent(in) :: cosines(:), last
      real(wp), allocatable :: unknowns(:)
      real(wp) :: y(2*m - 1, system%n_dof)
      y = 0.0_wp
      y(1::2, :) = reshape(cosines, [m, system%n_dof])
      unknowns = [curve%motion%reduced(reshape(y, [size(y)])), last]
    end function unknowns_of

    !> The way back.
    function cosines_of(unknowns) result(cosines)
      real(wp), intent(in) :: unknowns(:)
      real(wp) :: cosines(m*system%n_dof), y(2*m - 1, system%n_dof)
      y = curve%motion%expanded(unknowns(:curve%motion%n))
      cosines = reshape(y(1::2, :), [size(cosines)])
    end function cosines_of

  end subroutine follow_family

end module viscovib_free_family
