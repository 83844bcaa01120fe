!> A rigid body in space with finite rotations (`viscovib_rotation`), on mounts with directions
!! fixed in space. The coordinates are x, theta, and those of fluid tracks.
!!
!! A mount at the arm p, in body axes, has the deflection d = e . (x + R p - p); a rotational mount
!! has d = e . theta. With v_j = (1 - R_j*) [k_j d_j + g_j(d_j)], forces and moments are
!!
!!   m x'' = f - sum_j e_j (v_j + c_j d_j'),
!!   J omega' + omega x (J omega + h) = m_b - sum_j (p_j x R^T e_j) (v_j + c_j d_j')
!!                                           - sum_j T^-T e_j v_j,
!!
!! summed over translational and rotational mounts. h is the constant angular momentum of internal
!! rotors in body axes (Goldstein, Classical Mechanics, 5.5). The second equation is solved for
!! theta'' and multiplied by J, so that masses are constant. Its remainder also depends on rates and
!! loads:
!!
!!   M u'' + C u' + B v + r(u, u', v, load) = load.
!!
!! Coordinates are relative to the static equilibrium under the weight. There each mount carries a
!! constant preload P_j without memory, added to v_j in the moments, which rotate with the body. The
!! linear part of these moments uses three additional variables, on theta.
module viscovib_turning_body
  use viscovib_constants, only: pi
  use viscovib_dense, only: invert
  use viscovib_kernel_holder, only: copy_kernels, kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_law_term, only: law_term
  use viscovib_oscillator, only: oscillator_type
  use viscovib_rotation, only: cross, new_rotation, rotation_type
  implicit none
  private

  public :: body_spring, new_turning_body, row_of, turning_body

  !> Size of a complex step, whose square is negligible.
  real(wp), parameter :: tiny_step = 1.0e-100_wp
  !> Beyond this angle, somewhat more than pi, the rotation is described by the opposite vector.
  real(wp), parameter :: far_turned = 3.5_wp

  type :: body_spring
    integer :: kernel = 0
    !> True for a rotational mount.
    logical :: turning = .false.
    !> e and p (m).
    real(wp) :: direction(3) = 0.0_wp, arm(3) = 0.0_wp
    !> k, including the slope of its law, and c; static load.
    real(wp) :: stiffness = 0.0_wp, damping = 0.0_wp, preload = 0.0_wp
    !> Coordinate of the fluid track that it drives (0: none).
    integer :: track = 0
    !> g(d): coefficients by power from 2 on, and nonpolynomial laws.
    real(wp), allocatable :: coefficient(:)
    type(law_term), allocatable :: laws(:)
  end type body_spring

  type, extends(oscillator_type) :: turning_body
    type(body_spring), allocatable :: springs(:)
    !> True if loads are given in body axes.
    logical :: loads_turn = .false.
    !> h (kg m^2/s). C contains its effect at small rates.
    real(wp) :: spin_inside(3) = 0.0_wp
    real(wp) :: inertia(3, 3) = 0.0_wp
    real(wp), private :: inverse(3, 3) = 0.0_wp
    !> True if rotations that differ by a full turn are equivalent for all springs.
    logical, private :: winds = .false.
  contains
    procedure :: deflection_remainder
    procedure :: force_remainder
    procedure :: deflection_slopes
    procedure :: force_slopes
    procedure :: moving_remainder
    procedure :: moving_slopes
    procedure :: load_along
    procedure :: rename_state
    procedure :: weigh
  end type turning_body

contains

  subroutine new_turning_body(body, mass, damping, base_direction, springs, kernels)
    type(turning_body), intent(out) :: body
    !> For all coordinates, about the center of mass.
    real(wp), intent(in) :: mass(:, :), damping(:, :), base_direction(:)
    type(body_spring), intent(in) :: springs(:)
    type(kernel_holder), intent(in) :: kernels(:)
    real(wp) :: row(size(mass, 1))
    real(wp) :: bend(3, 3)
    integer :: i, j, m, n

    n = size(mass, 1)
    m = size(springs)
    body%springs = springs
    body%winds = .not. any(springs%turning)
    body%mass = mass
    call body%weigh(1.0_wp)
    body%damping = damping
    body%base_direction = base_direction
    call copy_kernels(kernels, body%kernels)
    body%kernel_of = springs%kernel
    bend = 0.0_wp
    if (any(abs(springs%preload) > 0.0_wp)) then
      bend = stiffness_of_preload(springs)
      body%kernel_of = [body%kernel_of, 0, 0, 0]
    end if
    allocate (body%gather(size(body%kernel_of), n), source=0.0_wp)
    allocate (body%spread(n, size(body%kernel_of)), source=0.0_wp)
    allocate (body%bent(size(body%kernel_of)), source=.false.)
    do i = m + 1, size(body%kernel_of)
      body%gather(i, 4:6) = bend(i - m, :)
      body%spread(3 + i - m, i) = 1.0_wp
    end do
    do j = 1, m
      row = row_of(springs(j), n)
      body%gather(j, :) = springs(j)%stiffness*row
      body%spread(:, j) = row
      body%bent(j) = any(abs(springs(j)%coefficient) > 0.0_wp) .or. size(springs(j)%laws) > 0 &
                     .or. any(abs(springs(j)%arm) > 0.0_wp)
    end do
    body%separable = .false.
    body%moving = .true.
    call body%drop_zero_kernels()
  end subroutine new_turning_body

  !> Scale the masses, and update the inertia and its inverse.
  subroutine weigh(self, factor)
    class(turning_body), intent(inout) :: self
    real(wp), intent(in) :: factor
    complex(wp) :: inverse(3, 3)
    logical :: singular
    self%mass = factor*self%mass
    self%inertia = self%mass(4:6, 4:6)
    call invert(cmplx(self%inertia, 0.0_wp, wp), inverse, singular)
    self%inverse = real(inverse)
  end subroutine weigh

  !> Derivatives by theta of the moments of constant forces at body points, in body axes; symmetric
  !! if the forces are in equilibrium.
  pure function stiffness_of_preload(springs) result(bend)
    type(body_spring), intent(in) :: springs(:)
    real(wp) :: bend(3, 3)
    complex(wp) :: theta(3), moment(3)
    type(rotation_type) :: turn
    integer :: b, j

    do b = 1, 3
      theta = (0.0_wp, 0.0_wp)
      theta(b) = cmplx(0.0_wp, tiny_step, wp)
      turn = new_rotation(theta)
      moment = (0.0_wp, 0.0_wp)
      do j = 1, size(springs)
        moment = moment + springs(j)%preload*moment_of(springs(j), turn)
      end do
      bend(:, b) = -aimag(moment)/tiny_step
    end do
  end function stiffness_of_preload

  !> Coefficients of the deflection for small motions.
  pure function row_of(spring, n) result(row)
    type(body_spring), intent(in) :: spring
    integer, intent(in) :: n
    real(wp) :: row(n)
    complex(wp), dimension(3) :: e, p

    row = 0.0_wp
    if (spring%turning) then
      row(4:6) = spring%direction
    else
      e = spring%direction
      p = spring%arm
      row(:3) = spring%direction
      row(4:6) = real(cross(p, e))
    end if
    if (spring%track > 0) row(spring%track) = -1.0_wp
  end function row_of

  !> k (d - linear part) + g(d).
  subroutine deflection_remainder(self, u, w)
    class(turning_body), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :)
    real(wp), intent(inout), contiguous :: w(:, :)
    type(rotation_type) :: turn
    real(wp) :: d(size(u, 1), 1), value(size(u, 1))
    complex(wp) :: p(3)
    integer :: i, j, power

    do j = 1, size(self%springs)
      if (.not. self%bent(j)) cycle
      associate (spring => self%springs(j))
        p = spring%arm
        do i = 1, size(u, 1)
          w(i, j) = 0.0_wp
          if (.not. spring%turning) then
            turn = new_rotation(cmplx(u(i, 4:6), 0.0_wp, wp))
            w(i, j) = sum(spring%direction*real(turn%moved(p)))
          end if
        end do
        d(:, 1) = matmul(u, self%spread(:, j)) + w(:, j)
        w(:, j) = spring%stiffness*w(:, j)
        value = 0.0_wp
        do power = size(spring%coefficient) + 1, 2, -1
          value = value*d(:, 1) + spring%coefficient(power - 1)
        end do
        w(:, j) = w(:, j) + value*d(:, 1)**2
        do i = 1, size(spring%laws)
          call spring%laws(i)%program%evaluate(d, value)
          w(:, j) = w(:, j) + value
        end do
      end associate
    end do
  end subroutine deflection_remainder

  !> Slopes (k + g') dd/du - k (its value at 0), with dd/dtheta = T^T (p x R^T e).
  subroutine deflection_slopes(self, u, slopes)
    class(turning_body), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :)
    real(wp), intent(inout), contiguous :: slopes(:, :, :)
    type(rotation_type) :: turn
    real(wp) :: d(size(u, 1), 1), tangent(size(u, 1)), value(size(u, 1)), by(size(u, 1), 1)
    real(wp) :: rows(size(u, 1), size(u, 2))
    complex(wp) :: p(3), e(3)
    integer :: b, i, j, power

    do j = 1, size(self%springs)
      if (.not. self%bent(j)) cycle
      associate (spring => self%springs(j))
        p = spring%arm
        e = spring%direction
        rows = spread(self%spread(:, j), 1, size(u, 1))
        d(:, 1) = matmul(u, self%spread(:, j))
        do i = 1, size(u, 1)
          if (spring%turning) exit
          turn = new_rotation(cmplx(u(i, 4:6), 0.0_wp, wp))
          d(i, 1) = d(i, 1) + sum(spring%direction*real(turn%moved(p)))
          rows(i, 4:6) = real(turn%spin_transposed(cross(p, turn%turned_back(e))))
        end do
        tangent = spring%stiffness
        do power = 2, size(spring%coefficient) + 1
          tangent = tangent + power*spring%coefficient(power - 1)*d(:, 1)**(power - 1)
        end do
        do i = 1, size(spring%laws)
          call spring%laws(i)%program%differentiate(d, value, by)
          tangent = tangent + by(:, 1)
        end do
        do b = 1, size(u, 2)
          slopes(:, j, b) = tangent*rows(:, b) - spring%stiffness*self%spread(b, j)
        end do
      end associate
    end do
  end subroutine deflection_slopes

  !> At zero rates and loads. The equations of motion use `moving_remainder`.
  subroutine force_remainder(self, u, v, f)
    class(turning_body), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :), v(:, :)
    real(wp), intent(out), contiguous :: f(:, :)
    call self%moving_remainder(u, 0.0_wp*u, v, 0.0_wp*u, f)
  end subroutine force_remainder

  subroutine force_slopes(self, u, v, by_u, by_v)
    class(turning_body), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :), v(:, :)
    real(wp), intent(out), contiguous :: by_u(:, :, :), by_v(:, :, :)
    real(wp) :: by_rate(size(u, 1), size(u, 2), size(u, 2))
    call self%moving_slopes(u, 0.0_wp*u, v, 0.0_wp*u, by_u, by_rate, by_v)
  end subroutine force_slopes

  subroutine moving_remainder(self, u, rate, v, load, f)
    class(turning_body), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :), rate(:, :), v(:, :), load(:, :)
    real(wp), intent(out), contiguous :: f(:, :)
    complex(wp) :: found(6)
    integer :: i

    f = 0.0_wp
    do i = 1, size(u, 1)
      call remainder_of(self, cmplx(u(i, :), 0.0_wp, wp), cmplx(rate(i, :), 0.0_wp, wp), &
                        cmplx(v(i, :), 0.0_wp, wp), load(i, :), found)
      f(i, :6) = real(found)
    end do
  end subroutine moving_remainder

  subroutine moving_slopes(self, u, rate, v, load, by_u, by_rate, by_v)
    class(turning_body), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :), rate(:, :), v(:, :), load(:, :)
    real(wp), intent(out), contiguous :: by_u(:, :, :), by_rate(:, :, :), by_v(:, :, :)
    complex(wp) :: x(size(u, 2)), y(size(u, 2)), z(size(v, 2)), found(6)
    type(rotation_type) :: turn
    integer :: b, i

    by_u = 0.0_wp
    by_rate = 0.0_wp
    by_v = 0.0_wp
    do i = 1, size(u, 1)
      x = u(i, :)
      y = rate(i, :)
      z = v(i, :)
      do b = 1, 6
        ! Nothing depends on x.
        if (b > 3) then
          x(b) = cmplx(u(i, b), tiny_step, wp)
          call remainder_of(self, x, y, z, load(i, :), found)
          by_u(i, :6, b) = aimag(found)/tiny_step
          x(b) = u(i, b)
        end if
        y(b) = cmplx(rate(i, b), tiny_step, wp)
        call remainder_of(self, x, y, z, load(i, :), found)
        by_rate(i, :6, b) = aimag(found)/tiny_step
        y(b) = rate(i, b)
      end do
      turn = new_rotation(x(4:6))
      do b = size(self%springs) + 1, size(v, 2)
        by_v(i, 4:6, b) = -self%spread(4:6, b)
      end do
      do b = 1, size(self%springs)
        found(:3) = matmul(self%inverse, moment_of(self%springs(b), turn))
        by_v(i, 4:6, b) = -matmul(self%inertia, real(turn%unspin(found(:3)))) &
                          - self%spread(4:6, b)
      end do
    end do
  end subroutine moving_slopes

  !> Loads from the balance of forces and moments.
  subroutine load_along(self, u, rate, acceleration, v, load)
    class(turning_body), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :), rate(:, :), acceleration(:, :), v(:, :)
    real(wp), intent(out), contiguous :: load(:, :)
    type(rotation_type) :: turn
    complex(wp), dimension(3) :: omega, force, moment, pull, speed
    real(wp) :: held
    integer :: i, j

    load = 0.0_wp
    do i = 1, size(u, 1)
      turn = new_rotation(cmplx(u(i, 4:6), 0.0_wp, wp))
      speed = rate(i, 4:6)
      omega = turn%spin(speed)
      force = matmul(self%mass(:3, :3), acceleration(i, :3))
      speed = acceleration(i, 4:6)
      moment = turn%spin(speed)
      speed = rate(i, 4:6)
      moment = matmul(self%inertia, moment + turn%spin_rate(speed)) &
               + cross(omega, matmul(self%inertia, omega) + self%spin_inside)
      do j = 1, size(self%springs)
        associate (spring => self%springs(j))
          pull = moment_of(spring, turn)
          held = v(i, j) + spring%damping*(sum(spring%direction*rate(i, :3)) &
                                           - sum(real(pull*omega)))
          if (.not. spring%turning) force = force + held*spring%direction
          moment = moment - pull*(held + spring%preload)
        end associate
      end do
      if (self%loads_turn) force = turn%turned_back(force)
      if (.not. self%loads_turn) moment = turn%turned(moment)
      load(i, :3) = real(force)
      load(i, 4:6) = real(moment)
    end do
  end subroutine load_along

  !> Switch to the opposite rotation vector if the angle is large: at 2 pi the rotation vector is
  !! singular. Rotational springs are not invariant, so the vector is kept. With `like`, choose the
  !! vector closer to those coordinates.
  subroutine rename_state(self, u, v, renamed, like)
    class(turning_body), intent(in) :: self
    real(wp), intent(inout) :: u(:), v(:)
    logical, intent(out) :: renamed
    real(wp), intent(in), optional :: like(:)
    real(wp) :: other(3)

    renamed = .false.
    if (.not. self%winds .or. .not. norm2(u(4:6)) > 0.0_wp) return
    other = u(4:6)*(1.0_wp - 2.0_wp*pi/norm2(u(4:6)))
    renamed = norm2(u(4:6)) > far_turned
    if (present(like)) renamed = norm2(other - like(4:6)) < norm2(u(4:6) - like(4:6))
    if (renamed) call take_other(u(4:6), v(4:6), other)
  end subroutine rename_state

  !> theta' of the other vector, from the same angular velocity.
  pure subroutine take_other(theta, rate, other)
    real(wp), intent(inout) :: theta(3), rate(3)
    real(wp), intent(in) :: other(3)
    type(rotation_type) :: before, after
    complex(wp) :: speed(3)

    before = new_rotation(cmplx(theta, 0.0_wp, wp))
    after = new_rotation(cmplx(other, 0.0_wp, wp))
    speed = rate
    rate = real(after%unspin(before%spin(speed)))
    theta = other
  end subroutine take_other

  !> Moment of a unit mount force, in body axes.
  pure function moment_of(spring, turn) result(moment)
    type(body_spring), intent(in) :: spring
    type(rotation_type), intent(in) :: turn
    complex(wp) :: moment(3), e(3), p(3)
    e = spring%direction
    p = spring%arm
    if (spring%turning) then
      moment = -turn%unspin_transposed(e)
    else
      moment = -cross(p, turn%turned_back(e))
    end if
  end function moment_of

  !> Remainder r of one state, for x and theta.
  pure subroutine remainder_of(self, u, rate, v, load, r)
    class(turning_body), intent(in) :: self
    complex(wp), intent(in) :: u(:), rate(:), v(:)
    real(wp), intent(in) :: load(:)
    complex(wp), intent(out) :: r(6)
    type(rotation_type) :: turn
    complex(wp), dimension(3) :: omega, moment, force, push, pull, bent
    complex(wp) :: resisted
    integer :: j

    turn = new_rotation(u(4:6))
    omega = turn%spin(rate(4:6))
    force = (0.0_wp, 0.0_wp)
    push = load(:3)
    moment = load(4:6)
    if (self%loads_turn) force = turn%turned(push) - push
    if (.not. self%loads_turn) moment = turn%turned_back(moment)
    do j = 1, size(self%springs)
      associate (spring => self%springs(j))
        pull = moment_of(spring, turn)
        moment = moment + pull*(v(j) + spring%preload)
        if (.not. spring%damping > 0.0_wp) cycle
        ! d' = e . x' + (p x R^T e) . omega.
        resisted = spring%damping*(sum(spring%direction*rate(:3)) - sum(pull*omega))
        force = force - resisted*spring%direction
        moment = moment + pull*resisted
      end associate
    end do
    moment = moment - cross(omega, matmul(self%inertia, omega) + self%spin_inside)
    bent = matmul(self%inverse, moment) - turn%spin_rate(rate(4:6))
    r(:3) = -force - matmul(self%damping(:3, :6), rate(:6))
    r(4:6) = load(4:6) - matmul(self%inertia, turn%unspin(bent)) &
             - matmul(self%damping(4:6, :6), rate(:6)) - matmul(self%spread(4:6, :), v)
  end subroutine remainder_of

end module viscovib_turning_body
