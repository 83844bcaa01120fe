!> Derivatives of the accelerations of a solution on fixed sides of switching surfaces, or sliding
!! on them.
!!
!! On fixed sides `linearise` gives them. In sliding, the accelerations are a = a_+ + sum_j mu_j b_j
!! with r_j = c_j + n_j . a = 0 (viscovib_switched_laws), so that
!!
!!   da = (1 - B (N B)^-1 N) (da_+ + sum_j mu_j db_j) - B (N B)^-1 (dc + dN a).
!!
!! db, dc and dN are fourth-order differences, exact if b, c and n are constant or linear.
module viscovib_motion_slopes
  use viscovib_driven_system, only: driven_system_type
  use viscovib_few_equations, only: solve
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_law_slopes, only: most_arguments
  use viscovib_polynomial_motion, only: polynomial_motion_type
  use viscovib_switched_laws, only: slide_directions, switched_laws
  implicit none
  private

  public :: has_slopes, motion_slopes

  !> Step of the differences, as a fraction of the largest coordinate or velocity.
  real(wp), parameter :: apart = 2.0_wp**(-7)

contains

  !> True if the derivatives are available: no hysteresis, and few arguments per law.
  pure logical function has_slopes(system)
    class(driven_system_type), intent(in) :: system
    integer :: i

    has_slopes = .false.
    select type (system)
    class is (polynomial_motion_type)
      has_slopes = .true.
      do i = 1, size(system%laws%laws)
        has_slopes = has_slopes .and. size(system%laws%laws(i)%arguments, 1) <= most_arguments
      end do
      do i = 1, size(system%laws%elements)
        has_slopes = has_slopes .and. system%laws%elements(i)%is_stop
      end do
    end select
  end function has_slopes

  !> da/dq and da/dv for a block of vector lanes, shape (n_lanes, equation, by).
  subroutine motion_slopes(system, q, v, drive, by_q, by_v)
    class(driven_system_type), intent(in) :: system
    real(wp), intent(in) :: q(n_lanes, system%n_dof), v(n_lanes, system%n_dof)
    real(wp), intent(in) :: drive(n_lanes, size(system%drives))
    real(wp), intent(out), dimension(n_lanes, system%n_dof, system%n_dof) :: by_q, by_v
    real(wp) :: a(n_lanes, system%n_dof)

    call system%linearise(q, v, drive, a, by_q, by_v)
    select type (system)
    class is (polynomial_motion_type)
      if (system%laws%n_slides() > 0) then
        call keep_sliding(system%laws, system%n_dof, system%laws%n_slides(), q, v, a, by_q, by_v)
      end if
    end select
  end subroutine motion_slopes

  !> Project derivatives and accelerations near the surfaces onto sliding.
  subroutine keep_sliding(laws, n_dof, slides, q, v, a, by_q, by_v)
    type(switched_laws), intent(in) :: laws
    !> `slides`: number of surfaces on which the solution slides.
    integer, intent(in) :: n_dof, slides
    real(wp), intent(in), dimension(n_lanes, n_dof) :: q, v, a
    real(wp), intent(inout), dimension(n_lanes, n_dof, n_dof) :: by_q, by_v
    real(wp), dimension(n_lanes, n_dof, slides) :: b, n
    real(wp) :: c(n_lanes, slides), mu(n_lanes, slides)
    real(wp) :: along(n_lanes, n_dof), m(slides, slides), x(slides)
    integer :: d, i, j

    call slide_directions(laws, q, v, b, c, n)
    do i = 1, n_lanes
      do j = 1, slides
        x(j) = -(c(i, j) + dot_product(n(i, :, j), a(i, :)))
        m(j, :) = matmul(n(i, :, j), b(i, :, :))
      end do
      call solve(m, x)
      mu(i, :) = x
      along(i, :) = a(i, :) + matmul(b(i, :, :), x)
    end do
    do d = 1, n_dof
      call project(by_q(:, :, d), changes(d, .true.))
      call project(by_v(:, :, d), changes(d, .false.))
    end do

  contains

    !> Derivatives of b mu, followed by those of c + n . a, by one coordinate or velocity.
    function changes(d, of_place) result(by)
      integer, intent(in) :: d
      logical, intent(in) :: of_place
      real(wp) :: by(n_lanes, n_dof + slides)
      real(wp), parameter :: weights(4) = [1.0_wp, -8.0_wp, 8.0_wp, -1.0_wp]/12.0_wp
      integer, parameter :: steps(4) = [-2, -1, 1, 2]
      real(wp) :: places(n_lanes, n_dof), rates(n_lanes, n_dof), h(n_lanes)
      real(wp), dimension(n_lanes, n_dof, slides) :: b_there, n_there
      real(wp) :: c_there(n_lanes, slides)
      integer :: k, p

      h = maxval(abs(q), 2)
      if (.not. of_place) h = maxval(abs(v), 2)
      where (.not. h > 0.0_wp) h = 1.0_wp
      h = apart*h
      by = 0.0_wp
      do k = 1, size(steps)
        places = q
        rates = v
        if (of_place) places(:, d) = q(:, d) + steps(k)*h
        if (.not. of_place) rates(:, d) = v(:, d) + steps(k)*h
        call slide_directions(laws, places, rates, b_there, c_there, n_there)
        do p = 1, slides
          by(:, :n_dof) = by(:, :n_dof) + spread(weights(k)*mu(:, p)/h, 2, n_dof) &
                               *(b_there(:, :, p) - b(:, :, p))
          by(:, n_dof + p) = by(:, n_dof + p) + weights(k)/h &
                                  *(c_there(:, p) - c(:, p) &
                                    + sum((n_there(:, :, p) - n(:, :, p))*along, 2))
        end do
      end do
    end function changes

    subroutine project(by, change)
      real(wp), intent(inout) :: by(n_lanes, n_dof)
      real(wp), intent(in) :: change(n_lanes, n_dof + slides)
      integer :: l, k

      by = by + change(:, :n_dof)
      do l = 1, n_lanes
        do k = 1, slides
          x(k) = -(change(l, n_dof + k) + dot_product(n(l, :, k), by(l, :)))
          m(k, :) = matmul(n(l, :, k), b(l, :, :))
        end do
        call solve(m, x)
        by(l, :) = by(l, :) + matmul(b(l, :, :), x)
      end do
    end subroutine project

  end subroutine keep_sliding

end module viscovib_motion_slopes
